"""Order of the API's pages: functions first, then classes, then values, each as in `__all__` or the source."""

from typing import Any

import griffe

KINDS = (griffe.Kind.FUNCTION, griffe.Kind.CLASS)


class FunctionsFirst(griffe.Extension):
    """Sorts the names that each module exports, by which mkdocstrings goes with `members_order: __all__`."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Sort the exports of a package's modules, once all of them are loaded."""
        modules = [pkg]
        while modules:
            module = modules.pop()
            modules += [
                member
                for member in module.modules.values()
                if not member.is_alias
            ]
            own_names = [
                name
                for name, member in module.members.items()
                if not member.is_alias
            ]
            names = dict.fromkeys((*map(str, module.exports or ()), *own_names))
            module.exports = sorted(
                names, key=lambda name: place(module.members.get(name))
            )


def place(member: griffe.Object | griffe.Alias | None) -> int:
    """Return where a member stands among others of a module."""
    return (
        KINDS.index(member.kind)
        if member is not None and member.kind in KINDS
        else len(KINDS)
    )
