"""What pyproject.toml cannot say: the configurations of configs/ go into the wheel."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class WithConfigs(build_py):
    """Copies configs/*.yaml beside the modules that read them by name."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            folder = Path(self.build_lib) / "skylight" / "training" / "configs"
            folder.mkdir(parents=True, exist_ok=True)
            for path in sorted(Path("configs").glob("*.yaml")):
                shutil.copy(path, folder)


setup(cmdclass={"build_py": WithConfigs})
