"""Environments that can be pickled, for worker processes and saved models."""

from typing import Any, Self


class MadeAgain:
    """Pickles as the arguments that it was made with. The copy has the same options, and no episode yet."""

    spec: Any
    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Keep the arguments."""
        instance = super().__new__(cls)
        instance._arguments = args, kwargs
        return instance

    def __reduce__(self) -> Any:
        """Return what pickle keeps."""
        args, kwargs = self._arguments
        return _make_again, (type(self), args, kwargs, self.spec)


def _make_again(kind: type[Any], args: tuple[Any, ...], kwargs: dict[str, Any], spec: Any) -> Any:
    instance = kind(*args, **kwargs)
    instance.spec = spec
    return instance
