# Every target sets itself up: a fresh clone needs only make and Python 3.11 or newer (with venv).
#   make demo     a rendered face with its true light, and two photographs; results in out/demo
#   make test     the tests that take minutes together; tells how many it leaves out
#   make night    what a release needs: all tests, walk-throughs, fuzzing, kills and mutants; hours
#   make lint     style, types, and which module may import which
#   make format   rewrite the code in the project's style
#   make bench    timings
#   make docs     the documentation as a site: see out/site/index.html; WALK=1 runs its walk-throughs
#   make wheel    the package for pip in dist/, tried in an empty environment
#   make studio   the studio's page and the viewer built anew from studio/; needs Node.js 20 or newer
#   make blender  the extension for Blender 4.2 and newer as a zip in dist/
#   make fuzz     every reader and the studio, 5 minutes each; SECONDS_EACH=3600 for longer
#   make clean    forget the environment and everything made; runs/ (training) stays
# Another Python:  make PYTHON=python3.12 test

PYTHON ?= python3
OUT ?= out/demo
JOBS ?= 2
SECONDS_EACH ?= 300
WALK ?= 0
VENV := .venv
unexport PYTHONDONTWRITEBYTECODE  # compiling and instrumenting what the tests import takes 20 s
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check

.DELETE_ON_ERROR:
.PHONY: help demo test test-all night lint format bench docs wheel studio blender fuzz clean

help:
	@sed -n 's/^#   //p' Makefile

demo: $(VENV)/.runtime
	$(BIN)/skylight demo --out $(OUT)

# One thread for each worker: torch's own threads would fight over the same cores.
# worksteal: a worker has neighbouring tests, so their fixtures are made once.
test: LEFT_OUT := -m "not slow"
test test-all: $(VENV)/.dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal $(LEFT_OUT) $(ARGS)

night: WALK := 1
night: test-all docs
	rm -rf out/night && mkdir -p out/night
	$(BIN)/python tools/kill_runs.py --out out/night/kill-runs.json
	$(BIN)/python tools/fuzz.py --seconds $(SECONDS_EACH) --findings out/night --out out/night/fuzz.json
	OMP_NUM_THREADS=1 $(BIN)/python tools/mutate.py --minutes 60 --out out/night/mutants.json

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

format: $(VENV)/.dev
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

# addopts without the shape checks of the tests, which cost time
bench: $(VENV)/.dev
	$(BIN)/python -m pytest -o addopts=--import-mode=importlib -s benchmarks $(ARGS)

docs: $(VENV)/.dev
	WALK=$(WALK) OMP_NUM_THREADS=$(JOBS) $(BIN)/sphinx-build -j $(JOBS) -W --keep-going -q docs out/site

wheel: $(VENV)/.dev
	$(BIN)/python tools/try_wheel.py

fuzz: $(VENV)/.dev
	$(BIN)/python tools/fuzz.py --seconds $(SECONDS_EACH) $(ARGS)

studio:
	cd studio && npm ci && npm run build

blender:
	$(PYTHON) tools/build_blender_extension.py

clean:
	rm -rf docs/_walkthroughs docs/_drawings docs/api/_packages studio/node_modules
	rm -rf $(VENV) build dist out *.egg-info .benchmarks .hypothesis .import_linter_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("skylight needs Python 3.11 or newer, $(PYTHON) is " + sys.version.split()[0] + ": say make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv --clear $(VENV)
	@touch $@

$(VENV)/.runtime: pyproject.toml constraints.txt | $(VENV)/.created
	$(PIP) install --quiet --constraint constraints.txt --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(VENV)/.created
	$(PIP) install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@ $(VENV)/.runtime
