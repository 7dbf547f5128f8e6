"""What every command does around its work: progress, one line for an error, exit codes, Ctrl-C.

Exit codes: 0 done; 1 the input or the machine; 2 wrong usage (argparse); 130 stopped by Ctrl-C or because
nobody reads the output any more.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar

from clsss.errors import DeviceError, InputError

if TYPE_CHECKING:
    import argparse

    from clsss.mesh import Mesh
    from clsss.simulate import Result

T = TypeVar("T")
STOPPED = 130
# Shares of a typical bake's time, so that one bar runs evenly over all stages.
_STAGES = {
    "device": 0.05,
    "cut cells": 0.14,
    "octree": 0.25,
    "exchange": 0.2,
    "source": 0.1,
    "single": 0.1,
    "solve": 0.13,
    "surface": 0.03,
}


def overall(stage: str, fraction: float) -> float:
    """Share of a whole bake that is done when `fraction` of `stage` is."""
    names = list(_STAGES)
    if stage not in names:
        return 0.0
    return sum(_STAGES[name] for name in names[: names.index(stage)]) + fraction * _STAGES[stage]


def run(command: Callable[[], None]) -> int:
    """Run a command and turn every way it can end into an exit code and at most one line on stderr."""
    warnings.showwarning = _warn
    try:
        command()
        sys.stdout.flush()
        return 0
    except (InputError, DeviceError) as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        return STOPPED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing more to flush at exit
        return STOPPED
    except MemoryError:
        return _fail("not enough memory; lower --resolution")
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}" if error.filename else error.strerror or str(error))
    except Exception as error:  # a bug of ours: still one line, and a way to see more
        if os.environ.get("CLSSS_TRACEBACK"):
            raise
        return _fail(
            f"this is a bug in clsss, please report it: {type(error).__name__}: {error} (CLSSS_TRACEBACK=1 shows where)"
        )


def run_and_leave(command: Callable[[], None]) -> None:
    """Run a command and end the process with its exit code."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # whoever started the process has closed it
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    logging.getLogger().addHandler(logging.NullHandler())  # libraries log tracebacks of what they then put up with
    try:
        code = run(command)
    except SystemExit as stop:  # argparse: help or wrong usage
        code = stop.code if isinstance(stop.code, int) else 2
    leave(code)


def leave(code: int) -> None:
    """End the process now: threads that still compute inside a driver must not hold it back."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    os._exit(code)


def _fail(message: str) -> int:
    print("clsss: error:", " ".join(message.split()), file=sys.stderr)
    return 1


def _warn(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    if issubclass(category, UserWarning):  # the others speak to developers
        from tqdm import tqdm

        tqdm.write(f"clsss: warning: {' '.join(str(message).split())}", file=sys.stderr)  # above the bar


def interruptible(work: Callable[[], T]) -> T:
    """Do the work in a thread, so that Ctrl-C ends the program while the work is inside a driver."""
    outcome: list[T] = []
    failure: list[BaseException] = []

    def attempt() -> None:
        try:
            outcome.append(work())
        except BaseException as error:
            failure.append(error)

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.2)
    if failure:
        raise failure[0]
    return outcome[0]


def load(args: argparse.Namespace) -> Mesh:
    """The mesh of the options; says how large it is taken to be."""
    from clsss.request import mesh_from, size_note

    if args.quiet:
        warnings.simplefilter("ignore", UserWarning)
    mesh = mesh_from(args)
    if not args.quiet:
        print(size_note(args, mesh), file=sys.stderr)
    return mesh


def bake(args: argparse.Namespace, mesh: Mesh, progress: Callable[[str, float], None] | None) -> Result:
    """Simulate what the options ask for."""
    from clsss.request import blockers_from, lights_from, medium_from
    from clsss.simulate import simulate

    result = simulate(
        mesh,
        medium_from(args, mesh),
        lights_from(args, mesh),
        resolution=args.resolution,
        adaptive=args.adaptive,
        tolerance=args.tolerance,
        precision=args.precision,
        device=args.device,
        phase=args.phase,
        scattering=args.scattering,
        blockers=blockers_from(args, mesh),
        progress=progress,
    )
    if not any(result.report["energy"]["deposited_W"]):
        warnings.warn("no light enters the mesh, so it stays black; look at --light", UserWarning, stacklevel=1)
    return result


@contextlib.contextmanager
def progress_bar(args: argparse.Namespace) -> Iterator[Callable[[str, float], None]]:
    """A bar that follows the stages it is told, if somebody watches."""
    from tqdm import tqdm

    watched = sys.stderr.isatty() and not args.quiet
    layout = "{desc:<12}{percentage:3.0f}% |{bar}| {elapsed}"
    with tqdm(total=1.0, disable=not watched, leave=False, bar_format=layout, file=sys.stderr) as bar:

        def show(stage: str, fraction: float) -> None:
            bar.set_description_str(stage, refresh=False)
            bar.update((overall(stage, fraction) if stage in _STAGES else fraction) - bar.n)

        yield show


def bake_with_bar(args: argparse.Namespace) -> Result:
    """Load and bake, with a progress bar; Ctrl-C works throughout."""
    from clsss.request import check

    interruptible(lambda: check(args))
    mesh = interruptible(lambda: load(args))
    with progress_bar(args) as show:
        return interruptible(lambda: bake(args, mesh, show))
