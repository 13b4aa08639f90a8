"""What an evaluation is, and how its items are measured: in parallel, each of them once.

An evaluation is a frozen dataclass, its settings are the fields. What does not depend on settings
(its name, the data that it needs, how a quick run differs) are attributes of the class. Also here:
where light probes, meshes and lists of photographs lie in a folder of data, and trained models,
each read once a process.
"""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, ClassVar

import skylight
from skylight.errors import InputError, SkylightError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import json_content
from skylight.io._files import INDEX_NAME, visible_files
from skylight.models._bundle import LightBundle, Model, load_bundle, load_model
from skylight.models._sphere import Places
from skylight.models.autoencoder import AutoencoderLight
from skylight.transport._mesh import MESH_SUFFIXES
from skylight.work._progress import CountProgress
from skylight.work._resumable import Workers, locked, share_work

Metrics = dict[str, dict[str, float]]  # method -> metric -> value
Rows = dict[str, dict[str, dict[str, float]]]  # method -> metric -> mean, median, std, n
CACHE = "items.jsonl"
# What evaluations with light probes need.
PROBES = "light probes with an index.csv"
PROBES_AND_MESHES = "a folder hdr of light probes with an index.csv, and a folder meshes"
# Sources that no number depends on.
UNMEASURED = (
    "cli.py",
    "maps/",
    "studio/",
    "training/",
    *(f"work/_{name}.py" for name in ("cluster", "memory", "processes", "progress", "resumable")),
    "evaluation/_main.py",
    "evaluation/_tables.py",
)


@dataclass(frozen=True, kw_only=True)
class Check:
    """A measured number and the goal it was set; an evaluation reports both and goes on."""

    value: float
    goal: str
    ok: bool

    @staticmethod
    def at_most(value: float, limit: float) -> "Check":
        return Check(value=value, goal=f"<= {limit:g}", ok=value <= limit)

    @staticmethod
    def at_least(value: float, limit: float) -> "Check":
        return Check(value=value, goal=f">= {limit:g}", ok=value >= limit)

    @staticmethod
    def within(value: float, low: float, high: float) -> "Check":
        return Check(value=value, goal=f"{low:g} to {high:g}", ok=low <= value <= high)

    @staticmethod
    def below(value: float, limit: float, whose: str) -> "Check":
        return Check(value=value, goal=f"< {limit:.4g} ({whose})", ok=value < limit)


@dataclass(frozen=True, kw_only=True)
class Item:
    """What one face, sky or photograph gave. ``facts`` is anything else worth keeping.

    ``problem`` says why methods are missing from ``metrics``; empty where none is.
    """

    name: str
    metrics: Metrics
    facts: dict[str, object] = field(default_factory=dict)
    problem: str = ""


@dataclass(frozen=True, kw_only=True)
class Evaluation(ABC):
    """What is measured: items, each by :meth:`measure`, and goals for their means.

    Every evaluation of the table :data:`skylight.evaluation._main.EVALUATIONS` has a field
    ``data``, the folder of its data.

    Attributes
    ----------
    title
        Its name on the command line.
    needs
        What the folder of data must hold; empty where there may be none.
    data_folder
        Where ``skylight evaluate all`` looks for that in its own folder of data: "" for that
        folder itself, None where it is run without any.
    quick
        Settings of a quick run, which shows the form of the results in minutes.
    selects
        Settings that choose items, and on which no item's result depends.
    """

    title: ClassVar[str]
    needs: ClassVar[str] = ""
    data_folder: ClassVar[str | None] = ""
    quick: ClassVar[Mapping[str, Any]] = {}
    selects: ClassVar[tuple[str, ...]] = ()

    seed: int = 0

    @classmethod
    def over(cls, data: Path | None, *, quick: bool = False) -> "Evaluation":
        """The evaluation of a folder, with its usual settings or those of a quick run.

        Raises
        ------
        InputError
            There is no such folder, or none is given and one is needed.
        """
        if cls.needs and data is None:
            raise InputError(f"{cls.title} needs --data DIR: {cls.needs}")
        if cls.needs and data is not None and not data.is_dir():
            raise InputError(f"{data}: there is no such folder; {cls.title} needs {cls.needs}")
        settings: dict[str, Any] = {"data": data, **(cls.quick if quick else {})}
        return cls(**settings)

    @property
    def name(self) -> str:
        """Its name in the results."""
        return self.title

    def config(self) -> dict[str, object]:
        """All that an item's result depends on, beside the code."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in self.selects}
        return {k: str(v.resolve()) if isinstance(v, Path) else v for k, v in own.items()}

    @abstractmethod
    def items(self) -> list[str]: ...

    @abstractmethod
    def measure(self, item: str, picture: Path) -> Item:
        """One item; may write ``picture``, a PNG strip for the contact sheet.

        An error that is skylight's own leaves the item out, its text is the item's problem.
        """

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        """Goals by name, and whether they are met."""
        return {}

    def illustrate(self, out: Path, rows: Rows, items: list[Item]) -> None:  # noqa: B027
        """Writes figures of its own into ``out``, from results and the items' pictures."""

    def with_model(self, model: Model | None, device: str) -> "Evaluation":
        """The same with a trained model of one's own, on a device.

        Raises
        ------
        InputError
            It uses no trained model, or does not work on a device of choice.
        """
        raise InputError(f"{self.title} uses no trained model: leave --model and --device out")

    def with_peers(self, peers: Mapping[str, Path]) -> "Evaluation":
        """The same with rows for the results of others, by name the folder that they lie in.

        Raises
        ------
        InputError
            It compares no results of others, or a folder holds none of its items.
        """
        raise InputError(f"{self.title} compares no results of others: leave --peer out")


@dataclass(frozen=True, kw_only=True)
class ProbeEvaluation(Evaluation):
    """An evaluation over light probes, of ``data`` or its folder hdr, with meshes or without."""

    needs = PROBES_AND_MESHES
    selects = ("data",)  # wherever it lies

    data: Path

    def config(self) -> dict[str, object]:
        return {**super().config(), "index": index_sha256(self.probes)}

    @property
    def probes(self) -> Path:
        return probes_folder(self.data)


def measure_all(
    evaluation: Evaluation,
    out: Path,
    *,
    workers: Workers,
    progress: CountProgress | None = None,
) -> list[Item]:
    """All items in order, those measured before with the same settings and code from the cache.

    Each is appended to ``out/items.jsonl`` as soon as it is there, so that a killed run goes on
    where it was. Processes use one thread each; ``workers=1`` stays in this process.
    """
    names = evaluation.items()
    tell = progress or (lambda count, total: None)
    pictures = out / "pictures"
    with locked(out, pictures):
        pictures.mkdir(exist_ok=True)
        config = {"name": evaluation.name, "code": code_hash(), **evaluation.config()}
        done = _read_cache(out / CACHE, config)
        missing = [name for name in names if name not in done]
        tell(len(names) - len(missing), len(names))
        with (out / CACHE).open("a") as stream:
            work = [(evaluation, name, picture_of(out, name)) for name in missing]
            for item in share_work(_measure, work, workers=workers):
                done[item.name] = item
                stream.write(json.dumps(asdict(item)) + "\n")
                stream.flush()
                missing.remove(item.name)
                tell(len(names) - len(missing), len(names))
    return [done[name] for name in names]


def picture_of(out: Path, item: str) -> Path:
    """Where an item's picture lies; one of a file in a folder has the folder in its name."""
    return out / "pictures" / f"{item.replace('/', '_')}.png"


def _measure(evaluation: Evaluation, name: str, picture: Path) -> Item:
    try:
        return evaluation.measure(name, picture)
    except SkylightError as error:
        return Item(name=name, metrics={}, problem=str(error))


def _read_cache(path: Path, config: dict[str, object]) -> dict[str, Item]:
    """Items of an earlier run with exactly this configuration; otherwise a fresh cache."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    items: dict[str, Item] = {}
    kept = [json.dumps(config, sort_keys=True)]
    if lines[:1] == kept:
        for line in lines[1:]:
            try:
                item = Item(**json.loads(line))
            except ValueError:  # cut off by a kill
                continue
            items[item.name] = item
            kept.append(line)
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(kept) + "\n", encoding="utf-8")
    return items


@cache
def code_hash() -> str:
    """SHA-256 over the sources and model files that make the numbers: others' are stale."""
    root = Path(str(skylight.__path__[0]))
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if name.startswith(UNMEASURED) or not path.is_file():
            continue
        if path.suffix == ".py" or "data" in name.split("/"):
            digest.update(name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def index_sha256(folder: Path) -> str:
    """Of a folder's index: results of another one are none of these."""
    return hashlib.sha256((folder / INDEX_NAME).read_bytes()).hexdigest()


def probes_folder(data: Path) -> Path:
    """``data/hdr`` where it has an index of maps, else ``data`` itself, else an error."""
    for folder in (data / "hdr", data):
        if (folder / INDEX_NAME).is_file():
            return folder
    raise InputError(
        f"{data}: no {INDEX_NAME} in it or in its folder hdr; it lists light probes (.exr, .hdr) "
        "in the columns file and category"
    )


def mesh_files(data: Path, usual: Sequence[str]) -> list[Path]:
    """As many meshes as are ``usual``, at least one: those where they are, others in their place.

    They are in ``data/meshes``, or in ``meshes`` beside ``data``.
    """
    data = data.resolve()
    for folder in (data / "meshes", data.parent / "meshes"):
        found = visible_files(folder, MESH_SUFFIXES) if folder.is_dir() else []
        if found:
            here = {path.name: path for path in found}
            others = [path for path in found if path.name not in usual]
            return [*(here[name] for name in usual if name in here), *others][: len(usual)]
    raise InputError(
        f"{data}: no mesh in its folder meshes; put one or more there ({', '.join(MESH_SUFFIXES)})"
    )


def read_index(path: Path) -> Any:
    """What a JSON file about a folder's photographs holds."""
    try:
        return json_content(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error})") from error


_of_folder = cache(load_model)


def trained_model(model: Model) -> LightBundle | Places:
    """That of a folder, read once."""
    return _of_folder(Path(model) if isinstance(model, str) else model)


@lru_cache(maxsize=4)
def trained_light(model: Model | None) -> AutoencoderLight:
    """The light model of a trained model, shared: do not modify it."""
    bundle = load_bundle() if model is None else trained_model(model)
    if isinstance(bundle, Places):
        raise InputError("skies are scored: give --model a model of skies, not of places")
    return bundle.light()
