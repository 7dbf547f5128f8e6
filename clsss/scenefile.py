"""Scene files: the options of a command kept in TOML, so that a bake can be repeated and shared.

Every key is an option's name and takes what the option takes, as text or as TOML numbers; relative paths start
at the scene file. What the command line says comes before what the file says.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from clsss import tomlfile
from clsss.errors import InputError
from clsss.grammar import PAINT, LightOption, joined
from clsss.options import (
    DEFAULT_MATERIAL,
    DEFAULTS,
    DEMO,
    add_camera,
    add_output,
    add_shared,
    add_window_size,
    conflict,
    default_lights,
)
from clsss.options import parse as parse_words

SUFFIX = ".toml"
# What each of these says of the medium, the others must not add to when it is given on the command line.
_MEDIA = ("material", "grid", "vertex_colours")
_MEDIUM_KEYS = (*_MEDIA, "sigma_a", "sigma_s", "g", "eta")
_FILES = ("mesh", "blockers", "grid", "output", "report")
_NO_KEYS = ("help", "save_scene", "quiet")


def _actions() -> dict[str, argparse.Action]:
    parser = argparse.ArgumentParser()
    for add in (add_shared, add_output, add_camera, add_window_size):
        add(parser)
    return {action.dest: action for action in parser._actions if action.dest not in _NO_KEYS}


def parse(parser: argparse.ArgumentParser, argv: list[str] | None) -> argparse.Namespace:
    """The options that a command line, its scene file and the defaults give, in this order.

    Raises
    ------
    InputError
        The scene file cannot be read, or has a key or a value that makes no sense.
    """
    args = parse_words(parser, argv)
    if "mesh" not in args:
        return args
    args.scene = scene = args.mesh if args.mesh.lower().endswith(SUFFIX) else ""
    values = read(scene) if scene else {}
    if any(getattr(args, key, None) is not None for key in _MEDIA):
        values = {key: value for key, value in values.items() if key not in _MEDIUM_KEYS}
    if scene:
        args.mesh = values.pop("mesh")
    for key, value in {**dict.fromkeys(_actions()), **DEFAULTS, **values}.items():
        if getattr(args, key, None) is None:
            setattr(args, key, value)
    if problem := conflict(args):
        if scene:
            raise InputError(f"{scene}: {problem}")
        args.parser.error(problem)
    return args


def read(path: str) -> dict[str, Any]:
    """What a scene file says, by the names of the options, as the command line would have given it.

    Raises
    ------
    InputError
        It cannot be read, lacks the mesh, or has a key or a value that makes no sense.
    """
    actions = _actions()
    table = tomlfile.read(path, actions)
    if "mesh" not in table:
        raise InputError(f"{path}: needs the key 'mesh', the path of a mesh file")
    values = {}
    for key, value in table.items():
        try:
            values[key] = _located(key, _converted(actions[key], value), Path(path).parent)
        except (ValueError, argparse.ArgumentTypeError) as error:
            raise InputError(f"{path}: {key}: {error}") from None
    return values


def _converted(action: argparse.Action, value: Any) -> Any:
    """What the command line would have made of the value."""
    if isinstance(action.const, bool):
        if not isinstance(value, bool):
            raise ValueError(f"needs true or false, got {value!r}")
        return value
    if isinstance(action, argparse._AppendAction):
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise ValueError(f"needs a list of texts in [ ], got {value!r}")
        return [action.type(item) if callable(action.type) else item for item in value]
    numeric = value if isinstance(value, list) else [value]
    if isinstance(value, str):
        text = value
    elif numeric and all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in numeric) and action.type:
        text = ",".join(map(repr, numeric))
    else:
        raise ValueError(f"needs a text in quotes{' or a number' * bool(action.type)}, got {value!r}")
    if action.choices is not None and text not in action.choices:
        raise ValueError(f"{text!r} is none of {', '.join(action.choices)}")
    return action.type(text) if callable(action.type) else text


def _located(key: str, value: Any, folder: Path) -> Any:
    """The value with its paths, which start at the scene file, made to start at the current folder."""
    return _repathed(key, value, lambda path: os.path.normpath(folder / path))


def _repathed(key: str, value: Any, move: Any) -> Any:
    if key == "lights":
        return [LightOption(o.kind, o.vector, o.strength, o.in_box, o.file and move(o.file)) for o in value]
    if key == "mesh" and value == DEMO and not Path(move(value)).exists():
        return value
    if key in _FILES:
        return [move(item) for item in value] if isinstance(value, list) else move(value)
    if key == "material" and value.lower().endswith(SUFFIX):
        return move(value)
    if key in ("mix", "vertex_colours"):
        return tuple(move(x) if isinstance(x, str) and x.lower().endswith(SUFFIX) else x for x in value)
    return value


def check(path: str) -> Path:
    """The path, once it is known that a scene can be written there."""
    from clsss.export import check_writable

    if not path.lower().endswith(SUFFIX):
        raise InputError(f"{path}: a scene file's name ends in {SUFFIX}")
    return check_writable(path)


def save(args: argparse.Namespace, path: str) -> None:
    """Write the options as a scene file, the defaults too, so that it means the same in a later version.

    Raises
    ------
    InputError
        It cannot be written.
    """
    import tomli_w

    from clsss.export import write_atomically

    folder = check(path).parent.resolve()
    values = {key: getattr(args, key) for key in _actions() if getattr(args, key) is not None}
    if not set(values) & {"material", "sigma_a", "vertex_colours"}:
        values["material"] = DEFAULT_MATERIAL
    values.setdefault("lights", default_lights(args.up))
    table = {
        key: _toml(key, _repathed(key, value, lambda p: os.path.relpath(os.path.abspath(p), folder)))
        for key, value in values.items()
    }
    write_atomically(path, tomli_w.dumps(table).encode())


def _toml(key: str, value: Any) -> Any:
    match key:
        case "size":
            return joined([value]) + "mm"
        case "lights":
            return [str(option) for option in value]
        case "mix":
            name, scale, seed = value
            return f"{name}:{'' if scale is None else joined([scale]) + 'mm'}:{seed}"
        case "vertex_colours":
            return ":".join(value) or PAINT
        case "window_size":
            return "{}x{}".format(*value)
        case "camera":
            return joined(value)
        case "sigma_a" | "sigma_s":
            return value[0] if len(value) == 1 else list(value)
    return value
