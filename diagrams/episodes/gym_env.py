"""The station as a Gymnasium environment: `gymnasium.make("diagrams.episodes.gym_env:Hindsight/PickPlace-v0")`.

What stands before the colon is imported first, by which the name is known; Gymnasium reads no entry points from 1.0 on.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.gym import DrakeGymEnv
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import ZeroOrderHold
from pydrake.systems.sensors import ImageRgba8U

from diagrams.episodes.sampling import EpisodeSampler
from diagrams.world.can_mover import CanMover
from diagrams.world.configuration import World
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import other_spot
from diagrams.world.scenario import Scenario, load_world
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import REST_SECONDS, TIME_LIMIT, TaskMonitor
from models.errors import InputError
from systems.disturbance import Disturbance
from systems.image_encoder import ENCODED, encoded_picture

NAME = "Hindsight/PickPlace-v0"


class Observation(LeafSystem):
    """What a policy sees, as Gymnasium wants it.

    .. pydrake_system::

        name: Observation
        input_ports: [rgb_image, posture]
        output_ports: [observation]

    Inputs:
        rgb_image: ImageRgba8U of width x height pixels.
        posture: (M,) rad and m.
    Outputs:
        observation: a new dictionary: `rgb` (112, 112, 3) uint8, a larger picture is averaged down to that; `posture`
            (M,), rad and m. Direct feedthrough of both.
    """

    def __init__(self, width: int, height: int, posture_size: int):
        """`width`, `height`: of the image, pixels; `posture_size`: M."""
        super().__init__()
        image = AbstractValue.Make(ImageRgba8U(width, height))
        self._image = self.DeclareAbstractInputPort("rgb_image", image)
        self._posture = self.DeclareVectorInputPort("posture", posture_size)
        self.DeclareAbstractOutputPort("observation", lambda: AbstractValue.Make({}), self._calc)

    def _calc(self, context: Context, output: AbstractValue) -> None:
        rgb = encoded_picture(self._image.Eval(context))
        output.set_value({"rgb": rgb, "posture": self._posture.Eval(context).copy()})


class PickPlaceEnv(DrakeGymEnv):
    """The arm and its task; a step is one control tick of 0.1 s.

    Observation: `rgb` (112, 112, 3) uint8, what the camera sees; `posture` (8,), seven joint angles, rad, and the
    commanded gap of the fingers, m. Action: the posture that is desired at the next tick (8,), rad and m, clipped to
    the arm's limits of position (not of speed). Reward: 1 in the tick in which the task is done (diagrams/world/task.py
    says when), which ends the episode, else 0. Truncated after 60 s plus the time disturbed, or where the physics
    diverged.

    `reset(seed=S)` gives the episode of `pick_place.py --seed S`; without a seed one is drawn by `np_random`.
    The information has the truth for scoring: `success`, `disturbed` (the disturbance is under way), `can_poses` (14,)
    (see PickPlaceStation), `seconds` and, of a new episode, its `seed`; where the physics diverged, as a tick before.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (as gymnasium.Env)

    def __init__(
        self,
        *,
        disturbance: str | dict[str, Any] | DisturbanceSpec = "none",
        can: Sequence[float] | None = None,
        vacant: str | None = None,
        world: World | str | Path | None = None,
        render_mode: str | None = None,
    ):
        """
        Args:
            disturbance: none, A, B or moved, sampled from the seed; or all of it: the fields of DisturbanceSpec, such
                as {"kind": "B", "level": 0.12, "hold_ticks": 20, "subtask": 1}.
            can: X Y of the can to pick, m, world; sampled where not given.
            vacant: left or right; sampled where not given.
            world: see diagrams/world/configuration.py; or the YAML file of one.
            render_mode: rgb_array: what the camera sees; None: nothing is rendered but what is observed.

        Raises InputError for what makes no episode.
        """
        if isinstance(disturbance, str):
            disturbance = DisturbanceSpec(kind=disturbance)
        elif isinstance(disturbance, dict):
            with _fitting("disturbance", disturbance, "see DisturbanceSpec"):
                disturbance = DisturbanceSpec(**disturbance)
        elif not isinstance(disturbance, DisturbanceSpec):
            raise InputError(f"the disturbance {disturbance!r} is none: give none, A, B, moved, or a dictionary")
        if render_mode not in (None, "rgb_array"):
            raise InputError(f"there is no render_mode '{render_mode}': choose rgb_array, or none")
        if isinstance(world, str | Path):
            world = load_world(Path(world))
        elif not isinstance(world, World | None):
            raise InputError(f"the world {world!r} is none: give a World, or the name of its YAML file")
        with _fitting("can", can, "give x and y in metres"):
            place = None if can is None else [float(value) for value in can]
        self._world = world or World()
        self._scenario = Scenario(can=place, vacant=vacant, disturbance=disturbance, world=self._world)
        with _fitting("disturbance", disturbance, "see DisturbanceSpec"):
            self._scenario.check()
        if disturbance.fault is not None:
            raise InputError(f"the environment has no fault '{disturbance.label}': choose none, A, B or moved")
        self._sampler = EpisodeSampler(self._world)
        period, initial = self._world.timing.period, self._world.initial_posture
        builder = DiagramBuilder()
        station = self._station = builder.AddSystem(PickPlaceStation(self._world))
        size = len(initial)
        # The command of a tick holds until the next one, as the controller's does.
        hold = self._hold = builder.AddNamedSystem("command", ZeroOrderHold(period, size))
        disturb = self._disturbance = builder.AddNamedSystem(
            "disturbance", Disturbance(posture_size=size, period=period)
        )
        mover = self._mover = builder.AddNamedSystem("can_mover", CanMover())
        camera = self._world.camera
        seen = builder.AddNamedSystem("observation", Observation(camera.width, camera.height, size))
        builder.ExportInput(hold.get_input_port(), "action")
        for source, port, target, name in (
            (hold, "y", disturb, "desired_posture"), (station, "approach_distance", disturb, "trigger"),
            (disturb, "disturbed_posture", station, "desired_posture"),
            (disturb, "ticks_since_onset", mover, "ticks_since_onset"), (mover, "can_place", station, "can_place"),
            (station, "rgb_image", seen, "rgb_image"), (station, "posture", seen, "posture"),
        ):  # fmt: skip
            builder.Connect(source.GetOutputPort(port), target.GetInputPort(name))
        for system, name in (
            (seen, "observation"),
            (station, "rgb_image"),
            (station, "can_poses"),
            (disturb, "active"),
        ):
            builder.ExportOutput(system.GetOutputPort(name), name)
        diagram = builder.Build()
        simulator = Simulator(diagram)
        state = station.plant.get_state_output_port()

        def monitor(root: Context) -> EventStatus:
            if np.isfinite(state.Eval(station.plant.GetMyContextFromRoot(root))).all():
                return EventStatus.DidNothing()
            return EventStatus.Failed(diagram, "the physics diverged")  # which the base class makes a truncation of

        simulator.set_monitor(monitor)
        lower, upper, _ = controller_limits(station)
        limits = gymnasium.spaces.Box(lower, upper, dtype=np.float64)
        self.metadata = {}  # the base class writes what it can render into it
        super().__init__(
            simulator=simulator,
            time_step=period,
            action_space=limits,
            observation_space=gymnasium.spaces.Dict(
                {
                    "rgb": gymnasium.spaces.Box(0, 255, (ENCODED, ENCODED, 3), np.uint8),
                    # What it touches may press a joint a little beyond its limits.
                    "posture": gymnasium.spaces.Box(lower - 1.0, upper + 1.0, dtype=np.float64),
                }
            ),
            reward=lambda system, context: 0.0,  # see step
            action_port_id="action",
            observation_port_id="observation",
            render_rgb_port_id="rgb_image",
            reset_handler=self._begin,
        )
        self.metadata, self.render_mode = PickPlaceEnv.metadata, render_mode

    def _begin(self, simulator: Simulator, context: Context, seed: int | None) -> None:
        seed = int(self.np_random.integers(2**31)) if seed is None else seed
        self._scenario.seed, world = seed, self._world
        episode = self._sampler.episode(self._scenario)
        station, given = self._station, episode.disturbance
        station.set_scene(context, np.asarray(episode.can_xy), episode.vacant)
        meter = station.approach_meter
        meter.set_subtask(meter.GetMyMutableContextFromRoot(context), given.subtask)
        for system in (self._disturbance, self._mover):
            system.set_parameters(system.GetMyMutableContextFromRoot(context), given)
        self._hold.SetVectorState(self._hold.GetMyMutableContextFromRoot(context), world.initial_posture)
        self.action_port.FixValue(context, world.initial_posture)
        simulator.Initialize()
        places = station.spot(episode.vacant), station.spot(other_spot(episode.vacant))
        self._task = TaskMonitor(*places, world.initial_posture, world.timing.period)
        last = round(REST_SECONDS / world.timing.period) + 1
        self._postures, self._ticks, self._disturbed = deque[np.ndarray](maxlen=last), 0, 0

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """See gymnasium.Env. Raises InputError for a scene that is out of reach, and for `options`: there are none."""
        if options:
            raise InputError(f"there are no options {options}: give `can`, `vacant` and `disturbance` to make")
        seen, _ = super().reset(seed=seed, options=options)
        self._postures.append(seen["posture"])
        return seen, self._information(False) | {"seed": self._scenario.seed}

    def render(self) -> np.ndarray:
        """(112, 112, 3) uint8 or larger, what the camera sees; raises InputError without a render_mode."""
        if self.render_mode is None:
            raise InputError("nothing is rendered without a render_mode: give make render_mode='rgb_array'")
        return super().render()

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """See gymnasium.Env."""
        wanted = np.asarray(action, float)
        if wanted.shape != self.action_space.shape or not np.isfinite(wanted).all():
            raise InputError(f"the action {action} is no posture: give {self.action_space.shape[0]} finite numbers")
        timing = self._world.timing
        self._ticks += 1
        # To half a step of the plant before the next tick: it is as that tick sees it, and no rounding decides.
        until = self._ticks * timing.period - 0.5 * timing.time_step
        self.time_step = until - self.simulator.get_context().get_time()
        bounds = self.action_space.low, self.action_space.high
        seen, _, _, diverged, _ = super().step(np.clip(wanted, *bounds))
        if diverged:
            return seen, 0.0, False, True, self._last | {"success": False}
        self._postures.append(seen["posture"])
        context = self.simulator.get_context()
        active = self._output("active")[0] > 0.5
        self._disturbed += int(active)
        gap, postures = self._station.finger_gap(context), np.array(self._postures)
        done = not active and self._task.success(self._output("can_poses"), postures, gap)
        late = self._ticks >= round(TIME_LIMIT / timing.period) + self._disturbed
        return seen, float(done), done, late and not done, self._information(done)

    def _output(self, name: str) -> np.ndarray:
        return self.simulator.get_system().GetOutputPort(name).Eval(self.simulator.get_context())

    def _information(self, success: bool) -> dict[str, Any]:
        self._last = {
            "success": success, "disturbed": bool(self._output("active")[0] > 0.5),
            "can_poses": self._output("can_poses").copy(), "seconds": self._ticks * self._world.timing.period,
        }  # fmt: skip
        return self._last


@contextmanager
def _fitting(what: str, value: Any, remedy: str) -> Iterator[None]:
    """Makes an InputError of what Python raises at a value of another type."""
    try:
        yield
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"the {what} {value!r} does not fit ({error}): {remedy}") from error


gymnasium.register(NAME, entry_point=f"{__name__}:PickPlaceEnv")
