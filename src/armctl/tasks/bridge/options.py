"""The options of the bridge environments."""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, ClassVar, Literal

from pydantic import Field, Strict

from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.tasks.bridge.state import REWARD, Term

WALKER_RADIUS = 0.25
"""m."""
WALKER_SPEEDS = (0.3, 1.2)
"""m/s."""
CONTROL_PERIOD = 0.1
"""s between two control steps."""
WALKER_PERIOD = 0.02
"""s between two moves of the walkers, who walk at most 24 mm in it."""
MOVES = round(CONTROL_PERIOD / WALKER_PERIOD)
"""Moves of the walkers per control step. Wheel speeds and torques are sampled as often."""
Blocks = Annotated[int, Field(ge=0, le=50)]
Walkers = Annotated[int, Field(ge=0, le=20)]
Side = Annotated[int, Field(ge=4, le=1024)]


@options
class BridgeOptions:
    """Options of the bridge environments."""

    deck_length: Annotated[float, Field(ge=8, le=200)] = 20.0
    """m."""
    deck_width: Annotated[float, Field(ge=3, le=20)] = 4.0
    """m; the barriers take 1.22 m of it."""
    blocks: Blocks = 7
    """Barrier blocks on the deck, at new places in each episode."""
    walkers: Walkers = 0
    """Person-sized obstacles that walk across and along the bridge."""
    pedestrians: Literal["scripted", "reactive"] = "scripted"
    """`scripted`: walkers give way to nobody. `reactive`: they slow down or step aside for the rover and for each
    other, by a social force; see `armctl.tasks.bridge.reactive`."""
    missing_barriers: Annotated[int, Field(ge=0, le=100)] = 1
    """Jersey barriers that are missing, different ones in each episode: there, the deck has an open edge."""
    dynamics: Literal["physics", "kinematic"] = "physics"
    """`kinematic`: without MuJoCo, for training. Dozens of times as fast; see `armctl.tasks.bridge.planar`."""
    observation: Literal["paper", "features", "full", "camera", "image", "state", "ranges"] = "paper"
    """`paper` or `camera`: a dict of `image` and own `motion`. `features`: the same, with depths as nearness, from 0 at
    infinity to 1. `image`: the image alone. `full` or `state`: pose, velocity and surroundings. `ranges`, only
    without physics: a dict of `ranges`, how far it is in each column of the depth camera to what stands on the deck or
    to a hole in it, m, and `motion`."""
    camera: Literal["depth", "classes", "rgb"] = "depth"
    """`depth` (m, along the optical axis), `classes` (an index into `PIXEL_CLASSES`) or `rgb` (needs OpenGL)."""
    resolution: Annotated[tuple[Side, Side] | None, Strict(False)] = None
    """Width and height of the camera image, pixels: by default (48, 32), with `image_format="uint8"` (48, 36)."""
    image_format: Literal["float", "uint8"] = "float"
    """`float`: images (height, width), depths in m. `uint8`: (height, width, 1), from 0 to 255 whatever they show, as
    convolutional networks take them. Colours are (height, width, 3) from 0 to 255 in either case."""
    field_of_view: Annotated[float, Field(ge=20, le=150)] = 110.0
    """Horizontal field of view of the camera, degrees."""
    camera_range: Annotated[float, Field(ge=0.5, le=1000)] = 10.0
    """Largest depth that the camera measures, m."""
    timestep: Annotated[float, Field(ge=1e-5, le=0.02)] = 0.005
    """Physics time step, s; see `benchmarks/physics_step.py`."""
    progress: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0
    """Reward per metre of progress towards the goal line, as an additional reward term."""
    reward: Mapping[str, Term] = field(default_factory=lambda: REWARD)
    """Named reward terms."""

    largest_block: ClassVar[tuple[float, float]] = (0.3, 0.8)
    """m: largest half length and half width of a block."""
    walker_radius: ClassVar[float] = WALKER_RADIUS
    """m."""
    fastest_walker: ClassVar[float] = WALKER_SPEEDS[1]
    """m/s."""
    blocks_vary: ClassVar[bool] = False
    """True if number and sizes of the blocks differ between episodes. Absent ones have size 0."""

    @property
    def view(self) -> str:
        """Kind of observation: `camera`, `features`, `image`, `ranges` or `state`."""
        return {"paper": "camera", "full": "state"}.get(self.observation, self.observation)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the camera image, pixels."""
        return self.resolution or ((48, 32) if self.image_format == "float" else (48, 36))

    def __post_init__(self) -> None:
        if self.observation == "features" and self.camera != "depth":
            raise ConfigurationError(
                f"observation='features' shows depths: it needs camera='depth', not {self.camera!r}"
            )
        if self.dynamics == "kinematic" and self.view not in ("state", "ranges"):
            raise ConfigurationError(
                f"dynamics='kinematic' has no images: observation is 'state' or 'ranges', not {self.observation!r}"
            )
        if self.observation == "ranges" and self.dynamics != "kinematic":
            raise ConfigurationError("observation='ranges' needs dynamics='kinematic': physics has a camera")
        chunks = WALKER_PERIOD / self.timestep
        if abs(chunks - round(chunks)) > 1e-6:
            raise ConfigurationError(
                f"timestep must divide {WALKER_PERIOD} s without remainder, which {self.timestep} does not"
            )


@options
class BridgeMovingOptions(BridgeOptions):
    """Options of `armctl/BridgeCrossMoving-v0`: the same, with fewer blocks, and walkers."""

    blocks: Blocks = 3
    walkers: Walkers = 3
