"""Lists the source files that two walks touch: an episode from command to verdict, an action to MuJoCo and back.

    python benchmarks/walks.py          # number of files by package, as in docs/architecture.md
    python benchmarks/walks.py --files  # the files too

A file is touched if a function of it is called, in Python or in a compiled kernel. Imports do not count.
"""

import contextlib
import io
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Annotated, Any

import gymnasium
import numpy as np
import typer
from numba.core.registry import CPUDispatcher
from printing import markdown_table, show

import armctl
from armctl.cli import app

ROOT = Path(__file__).resolve().parents[1]
PARTS = [ROOT / name for name in ("src/armctl", "baselines", "rl")]
POLICY, ENV = "reach_ik", "armctl/ArmReach-v0"


def touched(walk: Callable[[], Any]) -> list[str]:
    """Return the files of which a walk calls a function, relative to the repository."""
    files: set[str] = set()

    def called(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call" and frame.f_code.co_filename not in files and not is_import(frame):
            files.add(frame.f_code.co_filename)

    def run_kernel(kernel: Any, *arguments: Any) -> Any:
        files.update(kernel_files(kernel))
        return compiled_call(kernel, *arguments)

    compiled_call, CPUDispatcher.__call__ = CPUDispatcher.__call__, run_kernel
    sys.setprofile(called)
    try:
        walk()
    finally:
        sys.setprofile(None)
        CPUDispatcher.__call__ = compiled_call
    inside = (Path(file) for file in files)
    return sorted(str(file.relative_to(ROOT)) for file in inside if any(part in file.parents for part in PARTS))


def is_import(frame: FrameType | None) -> bool:
    """Return whether a frame is a part of an import: below `touched`, it is a module's body, or called from one."""
    while frame is not None and frame.f_code is not touched.__code__:
        if frame.f_code.co_name == "<module>":
            return True
        frame = frame.f_back
    return False


def kernel_files(kernel: Any) -> Iterator[str]:
    """Yield the file of a compiled kernel, and those of the kernels that it calls."""
    function = kernel.py_func
    yield function.__code__.co_filename
    for name in function.__code__.co_names:
        callee = function.__globals__.get(name)
        if isinstance(callee, CPUDispatcher) and callee is not kernel:
            yield from kernel_files(callee)


def episode() -> None:
    """Play a comparison of two policies in a folder of its own, as the command line does."""
    with TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        app(["compare", POLICY, "random", "--episodes", "10", "--out", folder], standalone_mode=False)


def action() -> Callable[[], Any]:
    """Return a control step of a policy, after the first one of an episode."""
    envs = gymnasium.make_vec(ENV, num_envs=1)
    policy = armctl.make_policy(POLICY, envs)
    observations, _ = envs.reset(seed=0)
    policy.reset(np.zeros(1, dtype=np.int32))
    observations, *_ = envs.step(policy.act(observations))
    return lambda: envs.step(policy.act(observations))


def main(files: Annotated[bool, typer.Option("--files", help="List the files too.")] = False) -> None:
    """Count the files that an episode and an action touch, by package."""
    walks = {
        "an episode, from command to verdict": touched(episode),
        "an action, to MuJoCo and back": touched(action()),
    }
    table = markdown_table("walk", "files", "by package")
    for name, walk in walks.items():
        packages = Counter(file.removeprefix("src/armctl/").rpartition("/")[0].partition("/")[0] for file in walk)
        table.add_row(name, str(len(walk)), ", ".join(f"{package or 'armctl'} {n}" for package, n in packages.items()))
    show(table)
    if files:
        for name, walk in walks.items():
            print(f"\n{name}:", *walk, sep="\n  ")


if __name__ == "__main__":
    typer.run(main)
