"""What of estimate.json goes into a page that is given away, checked."""

from typing import Any

LARGEST = 1e15  # beyond every number of an estimate, and products of several are finite
_ANGLES = {"azimuth_deg": float, "zenith_deg": float}
_RGB = _XYZ = [float, float, float]
# Whatever is not named here stays out of the page: paths, time and place among it.
SHOWN = {
    "light": str,
    "choice": ({"scene": str, "probability": float}, None),
    "sun": _ANGLES,
    "lamps": [{**_ANGLES, "irradiance": _RGB, "spread_deg": float}],
    "posterior": {
        "verdict": str,
        "is_seen": bool,
        "share": float,
        "region_radius_deg": float,
        "region_edge_per_sr": float,
        "region_parts": [{**_ANGLES, "share": float}],
    },
    "advice": [str],
    "faces": [
        {"number": int, "residual": float, "albedo": _RGB, "eyes": _XYZ, "forward": _XYZ},
    ],
    "seconds": {str: float},
}
# What the page is made of besides.
SEEN = {
    "sources": [str],
    "faces": [
        {
            "source": str,
            "focal_length_px": float,
            "picture_px": [int, int],
            "exposure": float,
            "white_balance": _RGB,
        },
    ],
}


def picked(value: Any, form: Any, name: str) -> Any:
    """The part of a JSON value that ``form`` describes, and nothing else of it.

    A form is a type, a list with the form of all elements or with the forms of so many, a dict
    with those of some keys (or of all of them, under ``str``), or a tuple of a form and None,
    where there may be null.

    Raises
    ------
    ValueError
        Something is missing, of another type or beyond :data:`LARGEST`; the message names it.
    """
    if isinstance(form, tuple):
        return None if value is None else picked(value, form[0], name)
    if isinstance(form, list):
        if not isinstance(value, list) or len(form) not in (1, len(value)):
            raise ValueError(f'"{name}" is no list' + (f" of {len(form)}" if len(form) > 1 else ""))
        forms = form if len(form) > 1 else form * len(value)
        return [picked(one, inner, name) for one, inner in zip(value, forms, strict=True)]
    if isinstance(form, dict):
        if not isinstance(value, dict):
            raise ValueError(f'"{name}" is no object')
        if str in form:
            return {key: picked(one, form[str], name) for key, one in value.items()}
        missing = [key for key in form if key not in value]
        if missing:
            raise ValueError(f'"{missing[0]}" is missing')
        return {key: picked(value[key], inner, key) for key, inner in form.items()}
    if type(value) in (int, float) and abs(value) > LARGEST:
        raise ValueError(f'"{name}" is too large')
    if form is float and type(value) in (int, float):
        return float(value)
    if form is float or type(value) is not form:
        raise ValueError(f'"{name}" is no {_IN_WORDS[form]}')
    return value


_IN_WORDS = {str: "text", bool: "true or false", int: "whole number", float: "number"}
