"""Environments that can be pickled, for worker processes and saved models."""

from typing import Any, Self


class MadeAgain:
    """Pickles as the arguments that it was made with. The copy has the same options, and no episode yet."""

    spec: Any
    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Keep the arguments."""
        made = super().__new__(cls)
        made._arguments = args, kwargs
        return made

    def __reduce__(self) -> Any:
        """What pickle keeps."""
        args, kwargs = self._arguments
        return _make_again, (type(self), args, kwargs, self.spec)


def _make_again(kind: type[Any], args: tuple[Any, ...], kwargs: dict[str, Any], spec: Any) -> Any:
    made = kind(*args, **kwargs)
    made.spec = spec
    return made
