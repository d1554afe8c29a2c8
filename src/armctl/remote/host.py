"""The other end of a connection: it answers messages by a policy or an environment, one for each connection.

Another Python, which may have no armctl, runs this module and `armctl.remote.messages` by themselves.
"""

import contextlib
import hashlib
import importlib
import importlib.util
import inspect
import os
import platform
import sys
import threading
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from armctl.remote.messages import LARGEST, VERSION, packed, unpacked

DECLARED = {"kind": str, "family": str, "training_steps": int, "interface": dict}
"""Attributes of a plain policy that are told, and their types."""
DEEPEST, LONGEST = 5, 200
"""Levels of an info that are told, and characters of a value that is none of a message's."""


class Handler(Protocol):
    """Answers to the messages of one connection."""

    metadata: dict[str, Any]
    """The first message to the other end."""

    def answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Return the answer. Whatever it raises is told, and the connection goes on."""

    def close(self) -> None:
        """Release everything when the connection ends."""


def serve(new_handler: Callable[[], Handler], host: str, port: int, on_ready: Callable[[int], None]) -> None:
    """Answer until the process ends; `port` 0 is any that is free. Browsers are refused, whatever page they show."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import ServerConnection
    from websockets.sync.server import serve as listen

    def talk(connection: ServerConnection) -> None:
        with contextlib.suppress(ConnectionClosed), contextlib.ExitStack() as stack:
            try:
                handler = new_handler()
                stack.callback(handler.close)
                connection.send(packed(handler.metadata))
            except (Exception, SystemExit):
                connection.send(traceback.format_exc())
                return
            for content in connection:
                try:
                    answer: bytes | str = packed(handler.answer(unpacked(content)))
                except (Exception, SystemExit):
                    answer = traceback.format_exc()
                connection.send(answer)

    with listen(talk, host, port, compression=None, max_size=LARGEST, origins=[None]) as server:
        on_ready(server.socket.getsockname()[1])
        server.serve_forever()


class Controllers:
    """A plain policy: a function of one observation, or a class with `act`, of which each world gets an instance."""

    def __init__(self, source: Any, identity: str) -> None:
        self._source, self._controllers = source, dict[int, Any]()
        facts = {
            name: getattr(source, name) for name, kind in DECLARED.items() if type(getattr(source, name, None)) is kind
        }
        self.metadata = {"armctl": VERSION, "identity": identity, **facts}

    def answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Begin episodes, or act."""
        if message.get("armctl") == "begin":
            for world in message["ids"].tolist():
                if not hasattr(self._controllers.get(world), "reset"):
                    self._controllers[world] = self._controller()
                getattr(self._controllers[world], "reset", lambda: None)()
            return {}
        start, actions, errors = perf_counter(), [], {}
        for world, controller in sorted(self._controllers.items()):
            try:
                actions.append(np.asarray(controller.act(_in_world(message["observation"], world)), dtype=float))
            except (Exception, SystemExit):
                errors[str(world)] = traceback.format_exc()
                actions.append(np.zeros(0))
        example = next((action for action in actions if action.size), np.zeros(0))
        complete = [np.zeros_like(example) if str(world) in errors else action for world, action in enumerate(actions)]
        return {
            "actions": np.array(complete),
            "errors": errors,
            "server_timing": {"infer_ms": 1e3 * (perf_counter() - start)},
        }

    def close(self) -> None:
        """Close nothing."""

    def _controller(self) -> Any:
        if isinstance(self._source, type):
            return self._source()
        if hasattr(self._source, "act"):
            return self._source
        return type("Function", (), {"act": staticmethod(self._source)})()


class Environment:
    """An environment of Gymnasium's, or of the older Gym's, made by an id or by what a module names."""

    def __init__(self, module: Any, name: str, identity: str) -> None:
        self._module, self._name = module, name
        self._env: Any = None
        self.metadata = {"armctl": VERSION, "identity": identity}

    def answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Make the environment, reset it, step it, or render it."""
        match message:
            case {"armctl": "make", "options": dict(options)}:
                self._env = self._make(options)
                return _facts(self._env)
            case {"armctl": "reset", "seed": seed}:
                return {"result": _plain(self._env.reset(seed=seed))}
            case {"armctl": "step", "action": action}:
                return {"result": _plain(self._env.step(action))}
            case {"armctl": "render"}:
                return {"result": np.asarray(self._env.render())}
        raise ValueError(f"an environment is not asked to {message.get('armctl')!r}")

    def close(self) -> None:
        """Close the environment."""
        if self._env is not None:
            self._env.close()

    def _make(self, options: dict[str, Any]) -> Any:
        maker = getattr(self._module, self._name, None)
        if callable(maker):
            return maker(**options)
        try:
            import gymnasium as gym
        except ImportError:
            import gym  # type: ignore[import-not-found,no-redef,unused-ignore]
        return gym.make(self._name, **options)


def _facts(env: Any) -> dict[str, Any]:
    spec, unwrapped = getattr(env, "spec", None), env.unwrapped
    period = getattr(unwrapped, "dt", None)
    return {
        "observation_space": _space(env.observation_space),
        "action_space": _space(env.action_space),
        "max_episode_steps": getattr(spec, "max_episode_steps", None) or getattr(env, "max_episode_steps", None),
        "dt": float(period) if isinstance(period, (int, float, np.floating)) else None,
        "metadata": _plain(dict(getattr(env, "metadata", None) or {})),
        "takes_seed": "seed" in (parameters := inspect.signature(unwrapped.reset).parameters)
        or any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()),
    }


def _space(space: Any) -> dict[str, Any]:
    kind = type(space).__name__
    if kind == "Box":
        return {kind: {"low": space.low, "high": space.high, "dtype": np.dtype(space.dtype).str}}
    if kind == "Discrete":
        return {kind: {"n": int(space.n), "start": int(getattr(space, "start", 0))}}
    if kind in ("MultiDiscrete", "MultiBinary"):
        return {kind: {"nvec": np.asarray(space.nvec)} if kind == "MultiDiscrete" else {"n": np.asarray(space.n)}}
    if kind == "Dict":
        return {kind: {name: _space(part) for name, part in space.spaces.items()}}
    if kind == "Tuple":
        return {kind: {str(i): _space(part) for i, part in enumerate(space.spaces)}}
    raise ValueError(
        f"spaces of another process are Box, Discrete, MultiDiscrete, MultiBinary, Dict, Tuple, not {kind}"
    )


def _plain(value: Any, level: int = 0) -> Any:
    """Return a value as a message can hold it: of other kinds, only the text."""
    if isinstance(value, (bool, int, float, str, type(None))):
        return value
    if isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in "biuf":
        return value
    if level < DEEPEST and isinstance(value, (list, tuple)):
        return [_plain(item, level + 1) for item in value]
    if level < DEEPEST and isinstance(value, dict):
        return {str(key): _plain(item, level + 1) for key, item in value.items()}
    return repr(value)[:LONGEST]


def _in_world(observations: Any, world: int) -> Any:
    """Return one world's observation of a batch."""
    if isinstance(observations, dict):
        return {name: _in_world(part, world) for name, part in observations.items()}
    return observations[world]


def _loaded(module: str) -> Any:
    """Import a module, by its name or its file's path, from the working directory too."""
    sys.path.append(str(Path.cwd()))
    if not module.endswith(".py"):
        return importlib.import_module(module)
    path = Path(module).resolve()
    sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise FileNotFoundError(f"there is no file {module}")
    loaded = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def _identity(module: Any, name: str) -> str:
    """Return what determines what this process answers, as far as it is known: its Python, and the module's file."""
    file = getattr(module, "__file__", None)
    checksum = hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16] if file else "built in"
    return f"{name}, {checksum}, Python {platform.python_version()}, NumPy {np.__version__}"


def _end_with_parent() -> None:
    """End this process once its standard input ends, as it does when the process that has started it has ended."""
    sys.stdin.buffer.read()
    os._exit(0)


def main(kind: str, module: str, name: str, descriptor: int) -> None:
    """Serve a policy or an environment; write the port, or a traceback, to a pipe."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with os.fdopen(descriptor, "w") as pipe:
        try:
            loaded = _loaded(module)
            identity = _identity(loaded, name)
            if kind == "policy":
                new_handler: Callable[[], Handler] = partial(Controllers, getattr(loaded, name), identity)
            else:
                new_handler = partial(Environment, loaded, name, identity)
        except (Exception, SystemExit):
            pipe.write(traceback.format_exc())
            return

        def tell(port: int) -> None:
            print(port, file=pipe)
            pipe.close()

        serve(new_handler, "127.0.0.1", 0, tell)
