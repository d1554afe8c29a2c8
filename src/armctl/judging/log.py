"""Trials of a real robot, logged by hand: a CSV file that is complete after every trial, and that `judge` reads.

Each initial condition is tried with all policies, one after the other, in an order that is drawn for it: what changes
during the day, such as light, batteries or the operator's patience, then favours none. Blinded, policies are letters
until all trials are logged, so that whoever judges success does not know which policy ran (double-blind if the
robot is started from the key by somebody else, or by a script).
"""

import csv
import io
import json
import os
import re
import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from armctl.core.errors import ConfigurationError, ResultsError, os_errors_as, reason
from armctl.core.files import bounded_text, write_atomically
from armctl.judging.values import numbers, truth

FORMAT = "armctl_log"
"""Key of the format number in the comment that a log begins with."""
VERSION = 1
COLUMNS = ("trial", "episode", "policy", "success", "time", "remark")
SECONDS = ("s", "sec", "secs", "second", "seconds")
OTHER_UNITS = (
    *("m", "min", "mins", "minute", "minutes", "h", "hr", "hour", "hours", "ms", "msec", "millisecond", "milliseconds"),
    *("%", "mm", "cm", "x", "step", "steps", "try", "tries", "trial", "trials", "time", "times", "attempt", "attempts"),
    *("retry", "retries", "collision", "collisions", "contact", "contacts", "drop", "drops", "object", "objects"),
)
"""Words after a number that is no time in seconds."""
QUANTITY = re.compile(r"([+\-\u2212]?[\d.,]*\d[\d.,]*)([^\W\d_]*|%)")
WORD = re.compile(r"[^\W\d_]+|%")
MAX_TIME = 86_400
"""s, the longest time of a trial."""
YES_NO = {True: "yes", False: "no"}


@dataclass
class TrialLog:
    """A log of trials, in its file after every change."""

    path: Path
    policies: Sequence[str]
    episodes: int
    """Number of initial conditions."""
    seed: int
    """Seed of the order of trials, and of the letters."""
    blind: bool
    """True while policies are letters."""
    rows: list[list[str]] = field(default_factory=list)
    """Trials so far, with `COLUMNS`."""
    task: str = ""
    """Task of the trials, as `judge` names it beside others; empty: nothing else is judged with it."""

    @classmethod
    def begin(
        cls,
        path: Path,
        policies: Sequence[str],
        episodes: int,
        seed: int,
        blind: bool,
        key: Path | None = None,
        task: str = "",
    ) -> "TrialLog":
        """Make a log; with `key`, also a JSON file of the policies by letter. Raises `ConfigurationError`."""
        names = [" ".join(name.split()) for name in policies]
        if len({name.casefold() for name in names}) < max(len(names), 2) or len(names) > len(string.ascii_uppercase):
            raise ConfigurationError(f"a log needs from 2 to 26 policies of different names, not {', '.join(names)}")
        if not all(names) or not 1 <= episodes <= 10_000:
            raise ConfigurationError("a log needs names of policies, and from 1 to 10,000 initial conditions")
        log = cls(path, names, episodes, seed, blind, task=" ".join(task.split()))
        with os_errors_as(f"{path} cannot be written"):
            if key is not None:
                write_atomically(key, json.dumps(log.letters, indent=2) + "\n")
            write_atomically(path, log.text)
        return log

    @classmethod
    def read(cls, path: Path) -> "TrialLog":
        """Read a log back; a last line that was cut off is dropped. Raises `ConfigurationError`."""
        try:
            text = bounded_text(path)
            header, _, body = text.partition("\n")
            plan = json.loads(header.removeprefix("#"))
            if plan[FORMAT] != VERSION:
                raise ValueError(f"it has format {plan[FORMAT]}, not {VERSION}")
            log = cls(
                path, plan["policies"], plan["episodes"], plan["seed"], plan["blind"], task=str(plan.get("task", ""))
            )
            whole, newline, torn = body.rpartition("\n")
            columns, *log.rows = csv.reader(io.StringIO(whole + newline, newline=""), strict=True)
            if tuple(columns) != COLUMNS or any(len(row) != len(COLUMNS) for row in log.rows):
                raise ValueError("its columns are not those of a log")
            log._check()
            if torn:  # by a crash in the midst of a trial, which is asked again
                log._rewrite()
        except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
            raise ConfigurationError(f"{path} is no log of armctl's, or was changed: {reason(error)}") from error
        return log

    @property
    def letters(self) -> dict[str, str]:
        """The policies by letter, drawn from the seed."""
        order = np.random.default_rng([self.seed, 0]).permutation(len(self.policies))
        return {string.ascii_uppercase[i]: self.policies[place] for i, place in enumerate(order.tolist())}

    @property
    def schedule(self) -> list[tuple[int, str]]:
        """Initial condition and policy of each trial, in their order; policies are letters while it is blind."""
        letters = {policy: letter for letter, policy in self.letters.items()}
        names = [letters[policy] if self.blind else policy for policy in self.policies]
        trials = []
        for episode in range(1, self.episodes + 1):
            order = np.random.default_rng([self.seed, episode]).permutation(len(names))
            trials += [(episode, names[place]) for place in order.tolist()]
        return trials

    @property
    def is_complete(self) -> bool:
        """True if all trials are logged."""
        return len(self.rows) == len(self.schedule)

    @property
    def text(self) -> str:
        """Content of the file."""
        plan = {FORMAT: VERSION, "policies": list(self.policies), "episodes": self.episodes, "seed": self.seed}
        if self.task:
            plan["task"] = self.task
        lines = io.StringIO(newline="")
        csv.writer(lines, lineterminator="\n").writerows([COLUMNS, *self.rows])
        return f"#{json.dumps({**plan, 'blind': self.blind})}\n{lines.getvalue()}"

    def add(self, success: bool, time: float | None, remark: str) -> None:
        """Log the next trial, and keep it before this returns. Raises `ResultsError`."""
        episode, policy = self.schedule[len(self.rows)]
        seconds = "" if time is None else f"{time:g}"
        row = [str(len(self.rows) + 1), str(episode), policy, YES_NO[success], seconds, " ".join(remark.split())]
        line = io.StringIO(newline="")
        csv.writer(line, lineterminator="\n").writerow(row)
        with os_errors_as(f"{self.path} cannot be written"), self.path.open("a", encoding="utf-8", newline="") as file:
            file.write(line.getvalue())
            file.flush()
            os.fsync(file.fileno())
        self.rows.append(row)

    def undo(self) -> list[str] | None:
        """Remove the last trial and return it; None if there is none. Raises `ResultsError`."""
        if not self.rows:
            return None
        removed = self.rows.pop()
        self._rewrite()
        return removed

    def unblind(self) -> None:
        """Write the policies' names in place of letters, for good. Raises `ResultsError`."""
        if self.blind:
            letters, self.blind = self.letters, False
            self.rows = [[*row[:2], letters[row[2]], *row[3:]] for row in self.rows]
            self._rewrite()

    def check_plan(self, policies: Sequence[str], episodes: int | None, seed: int | None, task: str = "") -> None:
        """Raise `ResultsError` unless a log is what was asked for, as far as something was."""
        requested: dict[str, list[str] | str | int | None] = {
            "policies": [" ".join(name.split()) for name in policies] or None, "episodes": episodes, "seed": seed,
            "task": " ".join(task.split()) or None,
        }  # fmt: skip
        for name, value in requested.items():
            if value not in (None, present := getattr(self, name)):
                raise ResultsError(f"{self.path} is a log of other {name}, {present}: leave them out to go on with it")

    def _rewrite(self) -> None:
        with os_errors_as(f"{self.path} cannot be written"):
            write_atomically(self.path, self.text)

    def _check(self) -> None:
        """Raise `ValueError` unless the trials are those of the schedule, in their order."""
        for i, (row, planned) in enumerate(zip(self.rows, self.schedule, strict=False), 1):
            if (row[0], int(row[1]), row[2]) != (str(i), *planned) or row[3] not in YES_NO.values():
                raise ValueError(f"trial {i} is not the one that was drawn")
        if len(self.rows) > len(self.schedule):
            raise ValueError("it has more trials than were planned")


def entry_of(line: str) -> tuple[bool, float | None, str]:
    """Return success, time and remark of a line such as `y`, `n 31.5` or `y 12 slow`. Raises `ConfigurationError`."""
    word, _, rest = line.strip().partition(" ")
    try:
        success = truth(word)
    except ValueError:
        raise ConfigurationError(f"{word!r:.40} is neither y nor n") from None
    first, _, remark = rest.strip().partition(" ")
    number, unit, remainder = "", "", remark
    if match := QUANTITY.fullmatch(first):
        number, unit = match.groups()
        if not unit and (match := WORD.match(remark)) and match[0].casefold() in (*SECONDS, *OTHER_UNITS):
            unit, remainder = match[0], remark[match.end() :].strip(" ,.;:")
    (time,) = numbers([number], "," if "," in number else ".")
    if not number and not first[:1].isdecimal():
        return success, None, rest.strip()
    if not isinstance(time, float) or not 0 <= time <= MAX_TIME or unit.casefold() not in ("", *SECONDS):
        raise ConfigurationError(
            f"{first} {unit if unit not in first else ''}".strip() + " is no time in seconds, as y 80 or n 80 s would "
            "have; before a remark that begins with a number write -, as in n - 3 collisions"
        )
    return success, time, remainder.strip()


def check_readable(source: str, plan: Mapping[str, Any], count: int) -> None:
    """Raise `ConfigurationError` for a log whose policies are letters still."""
    if plan.get("blind"):
        total = len(plan["policies"]) * plan["episodes"]
        raise ConfigurationError(
            f"{source} is blinded, and has {count} of {total} trials: finish it first, or end it with "
            f"armctl log {source} --unblind"
        )
