"""The distortion in a calibration file, by whatever names it has there.

What cannot be read is refused: images whose distortion is taken for none are tracked all the same, only worse.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import IdRgbdoError
from ..text.plain import shown
from .camera_words import by_name, number, numbers

ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # OpenCV's
RADIAL = ("k1", "k2", "k3", "k4", "k5", "k6")
TANGENTIAL = ("p1", "p2")
_MANY = r"coef(f|fs|s|ficients?)?|param(s|eters?)?|vec(tor)?|values?"
LISTS = {  # what keys without signs between their letters call a list of coefficients, and the order of these
    re.compile(rf"(lens|camera)?dist(o|ortion)?({_MANY})?|coeffs?|d1?"): ORDER,
    re.compile(rf"radial(dist(ortion)?)?({_MANY})?"): RADIAL,
    re.compile(rf"tangential(dist(ortion)?)?({_MANY})?"): TANGENTIAL,
}
LISTS_ALONE = ("d", "d1")  # of coefficients, but one number so called is none
INNER = re.compile(rf"data|{_MANY}")  # in a table that is called distortion itself
SUSPECT = re.compile(r"(?<!un)distort|dist_?coef|radial_?(dist|poly|coef)|tangential")  # no distances
HARMLESS = re.compile(r"radius|error|rms|std|cov|cent|resid|mean")  # where an Azure Kinect's hold, and how well
WRITTEN = 1e-4  # by which coefficients differ that were rounded
OTHER_CAMERA = re.compile(r"depth|infra|(?<![a-z])ir(?![a-z])")
MODELS = ("distortion_model", "model", "camera_model", "type", "distortion_type", "model_type", "lens_model")
OTHER_LENSES = ("fisheye", "equidist", "kannala", "inverse", "omni", "fov", "ftheta", "f-theta", "eucm", "division")
REALSENSE_MODELS = {1: "modified_brown_conrady", 2: "inverse_brown_conrady", 3: "ftheta", 5: "kannala_brandt"}

Coefficients = dict[str, float]  # by the names of ORDER


def read_distortion(levels: Sequence[Mapping[str, Any]], name: str, where: str, advice: str) -> Coefficients:
    """The coefficients that are not 0, by the names of ORDER.

    levels: the mapping with the camera's focal length, then those around it, inner ones first. name: what the camera
    is called there. advice: what to write for rectified images. Raises IdRgbdoError for distortion that cannot be read,
    differs from one place to another, or is of another kind of lens than OpenCV's radial and tangential one.
    """
    camera, *around = levels
    told: list[tuple[str, Coefficients]] = []
    for level in (_k_as_k1(camera), *around):
        own = {key: value for key, value in level.items() if _is_of(key, name) and not _is_one(value, levels)}
        told += _places(by_name(own), where)
    told = [(key, some) for key, values in told if (some := {name: value for name, value in values.items() if value})]
    other = next((key for key, values in told if not _same(values, told[0][1])), None)
    if other is not None:
        raise IdRgbdoError(f"{where}: expected one distortion, got {told[0][0]} and {other}; remove the wrong one")
    if not told:
        return {}
    _refuse_other_lenses(levels, where, advice)
    return told[0][1]


def _same(one: Coefficients, other: Coefficients) -> bool:
    """Whether two are the same but for the digits that were written."""
    return all(math.isclose(one.get(k, 0.0), other.get(k, 0.0), rel_tol=WRITTEN, abs_tol=WRITTEN) for k in ORDER)


def lists_distortion(key: str) -> bool:
    """Whether a key calls a list or a table of coefficients."""
    return _order(key) is not None


def _is_of(key: str, name: str) -> bool:
    """Whether a key may be that of the camera of this name: depth_distortion is not of a colour camera."""
    return OTHER_CAMERA.search(key.lower()) is None or OTHER_CAMERA.search(name.lower()) is not None


def _is_one(value: Any, levels: Sequence[Mapping[str, Any]]) -> bool:
    return any(value is level for level in levels)


def _k_as_k1(camera: Mapping[str, Any]) -> dict[str, Any]:
    """COLMAP's SIMPLE_RADIAL calls its one coefficient k; a list of that name is the matrix."""
    models = " ".join(str(value) for key, value in by_name(camera).items() if key in MODELS).lower()
    scalar = {key for key, value in camera.items() if key.lower() == "k" and _is_number(value) and "radial" in models}
    return {"k1" if key in scalar else key: value for key, value in camera.items()}


def _order(key: str) -> tuple[str, ...] | None:
    """The order of the coefficients under a key; None for a key of something else."""
    plain = re.sub(r"colou?r|rgb|[^a-z0-9]", "", key.lower())
    return next((order for pattern, order in LISTS.items() if pattern.fullmatch(plain)), None)


def _places(data: Mapping[str, Any], where: str, table: bool = False) -> list[tuple[str, Coefficients]]:
    """Each place in a mapping that tells the distortion, by its key; k1 to k6, or radial and tangential, are one.

    table: the mapping itself is called distortion, so that whatever stands in it belongs to it.
    """
    lists: list[tuple[str, Coefficients]] = []
    pieces: Coefficients = {}
    for key, value in data.items():
        order = _order(key)
        if (key in TANGENTIAL and len(numbers(value)) == 12) or (key in LISTS_ALONE and _is_number(value)):
            continue  # the projection matrix of a stereo camera; some number that is called d
        if key in ORDER:
            pieces[key] = _coefficient(key, value, where)
        elif order == ORDER:
            lists.append((key, _under(key, value, order, where)))
        elif order is not None:
            pieces |= _under(key, value, order, where)
        elif (table or SUSPECT.search(key)) and not HARMLESS.search(key) and _holds_fractions(value):
            raise IdRgbdoError(
                f"{where}: {shown(key, quoted=False)}: expected distortion as k1, k2, p1, p2, k3 or a list of them, "
                f"got {shown(value)}; write it so, or remove it"
            )
    return [*lists, ("k1", pieces)]


def _under(key: str, value: Any, order: tuple[str, ...], where: str) -> Coefficients:
    """The coefficients of a list, of a text of numbers, or of a table."""
    if isinstance(value, Mapping):
        return _in_table(key, by_name(value), order, where)
    if isinstance(value, str):
        value = re.sub(r"[][,;]", " ", value).split()
        value = value if value and value[0][0] in "+-.0123456789" else []  # else it is the name of a model
    elif not isinstance(value, list) and not _holds_fractions(value):  # a flag, or how many there are
        return {}
    found = numbers(value)
    if not found and value not in ([], [[]]):
        raise IdRgbdoError(f"{where}: {key}: expected numbers, got {shown(value)}; correct it")
    if any(found[len(order) :]):
        raise IdRgbdoError(
            f"{where}: {key}: expected at most {len(order)} distortion coefficients, got {len(found)}; rectify the "
            "images, then write a camera.toml with fx, fy, cx, cy of the rectified ones"
        )
    return dict(zip(order, found, strict=False))


def _in_table(key: str, table: Mapping[str, Any], order: tuple[str, ...], where: str) -> Coefficients:
    """The coefficients of a table such as {k1, k2, ...}, {radial, tangential}, {type, coeffs} or {rows, cols, data}."""
    found: Coefficients = {}
    for name in filter(INNER.fullmatch, table):
        found |= _under(f"{key}.{name}", table[name], order, where)
    for _, values in _places({name: table[name] for name in table if not INNER.fullmatch(name)}, where, table=True):
        found |= values
    return found


def _coefficient(key: str, value: Any, where: str) -> float:
    """A coefficient that stands alone; 0 where nothing is written."""
    found = number(value)
    if found is None or found == "":
        return 0.0
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise IdRgbdoError(f"{where}: {key}: expected a number, got {shown(value)}; correct it")
    return float(found)


def _is_number(value: Any) -> bool:
    return isinstance(number(value), int | float)


def _holds_fractions(value: Any) -> bool:
    """Whether there are numbers such as coefficients: a whole number that stands alone is a count or a flag."""
    if isinstance(value, Mapping):
        return any(map(_holds_fractions, value.values()))
    if isinstance(value, list):
        return any(map(_holds_numbers, value))
    return isinstance(value, int | float) and not float(value).is_integer()


def _holds_numbers(value: Any) -> bool:
    """Whether a number other than 0 is in a list of lists."""
    return any(map(_holds_numbers, value)) if isinstance(value, list) else isinstance(value, int | float) and value != 0


def _refuse_other_lenses(levels: Sequence[Mapping[str, Any]], where: str, advice: str) -> None:
    """Raises IdRgbdoError where a level, or a table of distortion in it, names a model that is not OpenCV's."""
    models = ""
    for level in levels:
        tables = (value for key, value in level.items() if lists_distortion(key) and isinstance(value, Mapping))
        for named in map(by_name, (level, *tables)):
            flags = [key for key, value in named.items() if value is True and key.removeprefix("is_") in OTHER_LENSES]
            stated = " ".join([*flags, *(str(named[name]) for name in MODELS if name in named)]).lower()
            models += " " + (REALSENSE_MODELS.get(number(named.get("model")), stated) if "ppx" in named else stated)
    if any(lens in models for lens in OTHER_LENSES):
        raise IdRgbdoError(
            f"{where}: expected radial and tangential distortion (plumb_bob, radtan, rational_polynomial), got "
            f"'{shown(models.strip(), quoted=False)}'; rectify the images, then {advice}"
        )
