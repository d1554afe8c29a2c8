"""Experts on arms that armctl was not made for, with and without boxes: no constant of an expert is for one arm.

    python benchmarks/arms.py [--episodes 24] [--seed 0] [--policy reach_mpc] [--arm UR5e] [--cache arms] [--workers 2]

Arms are the named ones, the same as files, and the files of `arms.csv`: without a wheel they are example-robot-data's;
the others are in wheels that pip downloads, by their checksums in `arms_wheels.txt`. A URDF says nothing of pairs of
links that cannot touch, nor of a home: the arm starts with its joints at zero, or in the middle of their range, or
above the floor if that is in it. Xacro files need `pip install xacrodoc`. Repairs are those that armctl's notes tell.

All targets can be reached and all layouts have a path, so each episode counts. `--policy reach_mppi` takes minutes an
arm.
"""

import contextlib
import csv
import importlib
import importlib.util
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import typer
from printing import markdown_table, progress, show

from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.robot_description import BUILTIN_ARMS, load_arm
from armctl.robot_description.arm import robot_data
from armctl.rollout import evaluate

FOLDER = Path(__file__).parent
REACH, OBSTACLES = "armctl/ArmReach-v0", "armctl/ArmReachObstacles-v0"
LINE_UP = (
    ("reach_ik", REACH), ("reach_mpc", REACH), ("reach_ruckig", REACH), ("reach_rate", REACH),
    ("reach_mpc", OBSTACLES), ("reach_ompl", OBSTACLES),
)  # fmt: skip
"""Policies, and environments for which they were made; the others do not see boxes."""
REPAIRS = {
    "no velocity limit": "velocities", "no effort limit": "efforts", "filled at": "masses",
    "added up": "links added up", "were raised": "moments raised", "that of its shapes": "inertia of shapes",
    "to have no mass": "light frames", "by its name": "tip by name", "Home is": "home above floor",
}  # fmt: skip
"""Texts in notes, and the repairs that they are about."""
PLATFORM = ("--only-binary", ":all:", "--python-version", "3.11", "--platform", "manylinux_2_28_x86_64")
"""One wheel of each, whatever runs this: their files are only read."""


@dataclass(frozen=True)
class Arm:
    """An arm's name, and where its URDF is."""

    name: str
    file: str
    tip: str | None
    wheel: str = ""
    """Folder of an unpacked wheel, by its name; empty: the file is installed, or a named arm."""
    package: str = ""
    """Folder in the wheel that lacks a `package.xml`."""
    replaced: str = ""
    replacement: str = ""
    density: str = ""
    """kg/m^3"""

    @property
    def kind(self) -> str:
        """Format of the file, and where it comes from."""
        if self.file in BUILTIN_ARMS:
            return "named"
        kind = {".xml": "MJCF", ".urdf": "URDF"}.get(Path(self.file).suffix, "xacro")
        return f"{kind}, {self.wheel or 'example-robot-data'}"

    def options(self, cache: Path) -> dict[str, Any]:
        """Return the environment's options; raises `ArmctlError` if armctl cannot read the arm."""
        more: dict[str, Any] = {"tip": self.tip} if self.tip else {}
        if self.density:
            more["density"] = float(self.density)
        if self.file in BUILTIN_ARMS:
            return {"robot": self.file}
        if not self.wheel:
            return {"robot": str(robot_data() / self.file), **more}
        folder = cache / self.wheel
        if self.package:
            (folder / self.package / "package.xml").touch()
        path = folder / self.file
        if path.suffix == ".xml":
            return {"robot": str(path), **more}
        text = expanded(path, folder) if "xacro:" in path.read_text() else path.read_text()
        copy = path.with_name(f"{path.name.split('.')[0]}_read.urdf")
        copy.write_text(text.replace(self.replaced, self.replacement) if self.replaced else text)
        return {"robot": str(copy), **more}


def expanded(path: Path, folder: Path) -> str:
    """Return the URDF of a xacro file; packages are folders below `folder`."""
    if importlib.util.find_spec("xacrodoc") is None:
        raise ConfigurationError("it is a xacro file: pip install xacrodoc")
    xacrodoc, packages = (importlib.import_module(name) for name in ("xacrodoc", "xacrodoc.packages"))
    roots = {root.name: str(root) for root in folder.glob("*/xacro/*")}
    kuka = {root.name: str(root) for root in folder.glob("*/xacro/kuka_description/*")}
    packages.update_package_cache(roots | kuka | {f"{name}_support": root for name, root in kuka.items()})
    with contextlib.chdir(path.parent):  # files include others by relative paths
        return str(xacrodoc.XacroDoc.from_file(path.name, resolve_packages=False).to_urdf_string())


def arms() -> Iterator[Arm]:
    """Yield the named arms, these as files, and those of `arms.csv`."""
    for name in BUILTIN_ARMS:
        yield Arm(name, name, None)
    for name, arm in BUILTIN_ARMS.items():
        yield Arm(f"{name}, as a file", arm.urdf, arm.tip)
    with (FOLDER / "arms.csv").open() as file:
        for row in csv.DictReader(file):
            name = row.pop("arm")
            yield Arm(name, **{key: value or "" for key, value in row.items()})


def fetch(cache: Path) -> None:
    """Download the wheels into `cache`, and unpack them, unless they are there."""
    wheels = FOLDER / "arms_wheels.txt"
    names = [line.split("==")[0].replace("-", "_") for line in wheels.read_text().splitlines()]
    if all((cache / name).is_dir() for name in names):
        return
    download = ("-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes", *PLATFORM, "--dest", str(cache))
    subprocess.run([sys.executable, *download, "--requirement", str(wheels)], check=True)
    for name in names:
        (wheel,) = cache.glob(f"{name}-*.whl")
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(cache / name)


def cells(options: dict[str, Any], columns: Iterable[tuple[str, str]], episodes: int, seed: int) -> Iterator[str]:
    """Yield the successes of each policy in its environment."""
    for policy, env in columns:
        results = evaluate(
            policy, env, episodes=episodes, seed=seed, worlds=episodes, env_options=options, policy_seed=0,
            lower_bound_steps=False,
        )  # fmt: skip
        yield str(int(results.success.sum()))


def row_of(
    arm: Arm, cache: Path, columns: Sequence[tuple[str, str]], episodes: int, seed: int
) -> tuple[str, ...] | str:
    """Return an arm's row of the table, or why it cannot be played."""
    warnings.simplefilter("ignore", UserWarning)
    try:
        options = arm.options(cache)
        robot = load_arm(**options)
        repairs = ", ".join(word for text, word in REPAIRS.items() if any(text in note for note in robot.notes))
        return arm.kind, str(robot.dof), repairs, *cells(options, columns, episodes, seed)
    except ArmctlError as error:
        return str(error)


def main(
    episodes: int = 24,
    seed: int = 0,
    policy: Annotated[list[str] | None, typer.Option()] = None,
    arm: Annotated[list[str] | None, typer.Option()] = None,
    cache: Path = FOLDER.parent / "results" / "arms",
    workers: int = 2,
) -> None:
    """Play, and print how many episodes are won on each arm."""
    chosen = [each for each in arms() if not arm or each.name in arm]
    if any(each.wheel for each in chosen):
        cache.mkdir(parents=True, exist_ok=True)
        fetch(cache)
    columns = list(LINE_UP) if policy is None else [(name, env) for name in policy for env in envs_of(name)]
    heads = (f"`{name}`{' among boxes' if env == OBSTACLES else ''}" for name, env in columns)
    table = markdown_table(f"episodes won of {episodes}", "file", "joints", "repaired", *heads)
    refused = markdown_table("arm", "cannot be played")
    totals = np.zeros(len(columns), int)
    play = joblib.delayed(row_of)
    rows = joblib.Parallel(workers, return_as="generator")(
        play(each, cache, columns, episodes, seed) for each in chosen
    )
    for each, row in zip(progress(chosen), rows, strict=True):
        if isinstance(row, str):
            refused.add_row(each.name, row)
        else:
            totals += np.array(row[-len(columns) :], int)
            table.add_row(each.name, *row)
    shares = totals / max(1, episodes * len(table.rows))
    table.add_row("all", "", "", "", *(f"{share:.1%}" for share in shares))
    show(table)
    if refused.rows:
        show(refused)


def envs_of(policy: str) -> list[str]:
    """Return the environments of a policy in the line-up, or both."""
    return [env for name, env in LINE_UP if name == policy] or [REACH, OBSTACLES]


if __name__ == "__main__":
    typer.run(main)
