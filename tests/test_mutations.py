"""Broken code is code still, broken in the ways that the tool says."""

import ast
from pathlib import Path

from tools.mutations import mutants_of

SOURCE = '''
"""Words are left alone."""
LIMITS = {"a": 1.5, "b": 0.0}


def mean(values: list[float], weights: list[float] = [1, 2]) -> float:
    """So are these."""
    if len(values) != len(weights) or not values:
        raise ValueError(f"{len(values)} values")
    total = sum(v * w for v, w in zip(values, weights, strict=True) if w > 0)
    values.append(max(total, 0))
    return total / sum(weights)
'''


def test_every_mutant_is_another_program_that_can_be_read(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(SOURCE)
    mutants = mutants_of(tmp_path, "a.py")
    programs = [ast.dump(ast.parse(mutant.source)) for mutant in mutants]
    assert ast.dump(ast.parse(SOURCE)) not in programs
    assert len(set(programs)) == len(programs)
    assert len({mutant.key for mutant in mutants}) == len(mutants)
    changes = {mutant.change for mutant in mutants}
    assert changes >= {
        "1.5  ->  3.0",
        "0.0  ->  1.0",
        '{"a": 1.5, "b": 0.0}  ->  without \'a\'',
        "len(values) != len(weights)  ->  (len(values) == len(weights))",
        "not values  ->  values",
        "v * w  ->  (v / w)",
        "v * w  ->  v",
        "zip(values, weights, strict=True)  ->  zip(weights, values, strict=True)",
        "w > 0  ->  (w <= 0)",
        "max(total, 0)  ->  min(total, 0)",
        "values.append(max(total, 0))  ->  pass",
        "total / sum(weights)  ->  (total * sum(weights))",
        "len(values) != len(weights) or not values  ->  True",
    }
    assert not any("Words" in change or "So are these" in change for change in changes)
    assert not any(mutant.kind == "without strict=" for mutant in mutants)
    inside = {mutant.in_function for mutant in mutants if mutant.old == "1.5"}
    assert inside == {False}
    (division,) = [mutant for mutant in mutants if mutant.old == "total / sum(weights)"]
    assert (division.in_function, division.lines) == (True, (12,))
