"""What is asked of the codes of a transport matrix's rows."""

from pathlib import Path

import pytest

from skylight.evaluation._transport_compression import COUNTS, TransportCompression


@pytest.mark.parametrize("worse", ["ani_l1", "iso_l1", "vmf_l1"])
def test_every_code_is_asked_to_be_closer_than_harmonics(tmp_path: Path, worse: str) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "any.ply").touch()
    (tmp_path / "index.csv").write_text("file,category\na.exr,indoor\n")
    errors = {"ani_l1": 0.1, "iso_l1": 0.2, "vmf_l1": 0.3, "ani_nnls": 0.9, "sh": 0.5, worse: 0.6}
    rows = {
        name: {f"l2_{count}": {"mean": error} for count in COUNTS} for name, error in errors.items()
    }
    checks = TransportCompression(data=tmp_path).checks(rows, [])
    missed = [name for name, check in checks.items() if not check.ok]
    assert missed == [f"{worse}, {count}" for count in COUNTS]
    assert len(checks) == 3 * len(COUNTS)
