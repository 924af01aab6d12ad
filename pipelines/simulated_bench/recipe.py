"""The bench recipe: every number of the simulated test bench, as frozen settings filled from TOML.

Every feature has a neutral setting (its default), so that a recipe switches on exactly what it names.
Effects carry the parameter conventions of ``docs/effects``: a dead-band takes ``positive`` and ``negative`` off the command and
leaves the slope, backlash is given by its full width, ``direction_ratio`` is the speed at command −1 over that at +1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from simulated_bench.capture_recipe import CaptureSettings
from simulated_bench.hydraulic_recipe import HydraulicSettings, MassSettings, OilSettings, SupplySettings
from simulated_bench.irregular import IrregularSettings
from sysid.config import Strict
from sysid.errors import SettingsError, nearest

#: The axes of the crane, from the base outwards. Cylinders move the second and third, the others are driven directly.
AXES = ("slew", "boom", "stick", "telescope")
#: The axes that have a draw wire: two cylinders and the telescope.
WIRED = AXES[1:]


@dataclass(frozen=True)
class ValveSettings(Strict):
    """From the command to the speed of one drive.

    Args:
        gain: speed per opening [m/s or rad/s], so that of command 1 without a dead-band.
        delay: transport delay [s].
        time_constant: first-order lag of the spool [s]; 0 = none.
        deadband_positive, deadband_negative: overlap of the spool on either side [command], both ≥ 0.
        saturation: opening beyond which the flow no longer rises [command].
        direction_ratio: speed at −1 over speed at +1 (area ratio of a cylinder).
        notch: share of the full opening over which V-notches meter before the whole edge does; 0 = no notches.
        taper: relative excess width of the metering edge at full opening over the average; below 0: narrower.
        silt: command that frees a spool which rests with closed ports (locked by particles); then it moves freely.
        spool_speed: largest speed of the spool, limited by pilot stage or ramp [command/s].
        disturbance: standard deviation of a slow relative flow fluctuation [1].
        disturbance_time: its correlation time [s].
    """

    gain: float
    delay: float = 0.0
    time_constant: float = 0.0
    deadband_positive: float = 0.0
    deadband_negative: float = 0.0
    saturation: float = math.inf
    direction_ratio: float = 1.0
    notch: float = 0.0
    taper: float = 0.0
    silt: float = 0.0
    spool_speed: float = math.inf
    disturbance: float = 0.0
    disturbance_time: float = 1.0


@dataclass(frozen=True)
class CylinderSettings(Strict):
    """A cylinder in a triangle with two levers that meet at the joint.

    ``length² = a² + b² − 2ab·cos(sense·(q + offset))``; displacement = length − ``retracted``, between 0 and ``stroke``.
    """

    a: float
    b: float
    offset: float
    retracted: float
    stroke: float
    sense: Literal[1, -1] = 1


@dataclass(frozen=True)
class AxisSettings(Strict):
    """One axis.

    Args:
        limits, park: range of the joint and where it is parked [rad or m].
        cylinder: None = the joint is driven directly.
        backlash: full width between drive and structure [rad or m].
        drive: the simple model of the valve, or the hydraulic circuit with the booms' dynamics (needs ``hydraulics``).
        stiffness: of the structure at the joint [N·m/rad]; it sags under its weight; ``flex_damping``: damping ratio.
        irregular: behaviour of the drive outside the catalogue (of a simple valve only).
    """

    valve: ValveSettings
    limits: tuple[float, float]
    park: float
    cylinder: CylinderSettings | None = None
    backlash: float = 0.0
    drive: Literal["valve", "hydraulic"] = "valve"
    hydraulics: HydraulicSettings | None = None
    stiffness: float = math.inf
    flex_damping: float = 0.05
    irregular: IrregularSettings = field(default_factory=IrregularSettings)


@dataclass(frozen=True)
class GeometrySettings(Strict):
    """Link lengths [m]: base to boom joint (upwards), boom joint to stick joint, stick joint to boom tip at telescope zero."""

    height: float
    boom: float
    stick: float


@dataclass(frozen=True)
class BuildSettings(Strict):
    """Deviations of the built machine from its drawing (``geometry``) and the zeros of its joints.

    Args:
        boom, stick: length errors of the links [m].
        joint_offset: true joint less what a perfect sensor with the stated zero shows [rad or m], by axis.
    """

    boom: float = 0.0
    stick: float = 0.0
    joint_offset: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SensorSettings(Strict):
    """A sensor that reads ``scale``·value + ``bias`` in multiples of ``quantum`` (SI).

    A draw wire may be mounted ``aside`` of the line it measures, ``standoff`` ahead of its drum at zero [m]: it then reads
    ``√((standoff + value)² + aside²) − √(standoff² + aside²)``.
    """

    signal: Literal["slew.joint", "boom.cylinder", "stick.cylinder", "telescope.joint"]
    bias: float = 0.0
    scale: float = 1.0
    quantum: float = 0.0
    aside: float = 0.0
    standoff: float = 0.0


@dataclass(frozen=True)
class GripperSettings(Strict):
    """A tool on two passive crossed joints below the boom tip; ``length`` 0 = rigidly at the tip."""

    length: float = 0.0
    damping_ratio: float = 0.0


@dataclass(frozen=True)
class WireSettings(Strict):
    """A draw wire: white noise [m], then the quantum of its counter [m]."""

    noise: float = 0.0
    quantum: float = 0.0


@dataclass(frozen=True)
class SlewSensorSettings(Strict):
    """An inductive angle sensor: smooth systematic error (bound), white noise, the quantum of its converter [rad].

    ``mount``: on the structure or on the drive, before the backlash.
    """

    error: float = 0.0
    noise: float = 0.0
    quantum: float = 0.0
    mount: Literal["structure", "drive"] = "structure"


@dataclass(frozen=True)
class ControllerSettings(Strict):
    """The machine's computer: its cycle [Hz], its clock at the start of the first recording [ns], and its log.

    A message is published ``publish_delay`` after its stamp and logged ``transport_delay`` later still [s];
    each delay has an exponentially distributed part of the given ``jitter`` (mean, [s]).
    ``log``: formats, messages (``mcap``) or CAN frames (``blf``, ``asc``), which the logger stamps when they are published;
    the site's recipe maps the first one.
    """

    rate: float = 100.0
    epoch_ns: int = 0
    publish_delay: float = 0.0
    transport_delay: float = 0.0
    jitter: float = 0.0
    log: tuple[Literal["mcap", "blf", "asc"], ...] = ("mcap",)


@dataclass(frozen=True)
class StrokeSettings(Strict):
    """One stroke of ``axis``: start [s], duration [s], level [command], and its smooth edges [s]."""

    axis: Literal["slew", "boom", "stick", "telescope"]
    start: float
    duration: float
    level: float
    edge: float = 0.1


@dataclass(frozen=True)
class RecordingSettings(Strict):
    """One recording: ``seconds`` of a ``program`` (an operator by default), or ``poses`` poses of the calibration routine.

    ``strokes`` are those of the program ``script``; ``flight`` is closed-loop operation by a controller.
    """

    name: str
    seed: int
    seconds: float = 0.0
    poses: int = 0
    program: Literal["operator", "reversals", "stairs", "steps", "together", "rest", "script", "flight"] = "operator"
    strokes: tuple[StrokeSettings, ...] = ()

    @property
    def is_calibration(self) -> bool:
        return self.poses > 0


@dataclass(frozen=True)
class OperatorSettings(Strict):
    """Behaviour of the operator.

    Args:
        parked: rest at the start [s].
        pause_every, pause: mean time between pauses of all axes [s], and their duration (range, [s]).
        slow_share: share of slow strokes around the dead-band.
        margin: share of the range kept clear at either end stop.
    """

    parked: float = 3.0
    pause_every: float = 14.0
    pause: tuple[float, float] = (2.0, 3.5)
    slow_share: float = 0.3
    margin: float = 0.06


@dataclass(frozen=True)
class RoutineSettings(Strict):
    """The calibration routine: waits ``settle`` after arrival, then records the machine at rest for ``hold`` [s]."""

    settle: float = 1.0
    hold: float = 1.2
    log_rate: float = 10.0
    inset: float = 0.02


@dataclass(frozen=True)
class HiddenSettings(Strict):
    """An effect of the machine (contract name and target) that its description does not contain."""

    name: str
    target: str


@dataclass(frozen=True)
class BenchRecipe(Strict):
    """The whole simulated test bench and the recordings to take; read by :func:`simulated_bench.recipe_file.load_recipe`."""

    schema: Literal[1]
    name: str
    seed: int
    geometry: GeometrySettings
    axes: dict[str, AxisSettings]
    recordings: tuple[RecordingSettings, ...]
    step: float = 0.001
    build: BuildSettings = field(default_factory=BuildSettings)
    gripper: GripperSettings = field(default_factory=GripperSettings)
    masses: MassSettings = field(default_factory=MassSettings)
    supply: SupplySettings = field(default_factory=SupplySettings)
    oil: OilSettings = field(default_factory=OilSettings)
    draw_wire: WireSettings = field(default_factory=WireSettings)
    sensors: tuple[SensorSettings, ...] = ()
    slew_sensor: SlewSensorSettings = field(default_factory=SlewSensorSettings)
    controller: ControllerSettings = field(default_factory=ControllerSettings)
    capture: CaptureSettings = field(default_factory=CaptureSettings)
    operator: OperatorSettings = field(default_factory=OperatorSettings)
    routine: RoutineSettings = field(default_factory=RoutineSettings)
    hidden: tuple[HiddenSettings, ...] = ()

    @property
    def built_geometry(self) -> GeometrySettings:
        """The links of the built machine."""
        return GeometrySettings(
            self.geometry.height, self.geometry.boom + self.build.boom, self.geometry.stick + self.build.stick
        )

    def sensor(self, signal: str) -> SensorSettings | None:
        return next((sensor for sensor in self.sensors if sensor.signal == signal), None)

    def drive_signal(self, axis: str) -> str:
        """The signal that measures the drive of an axis."""
        return f"{axis}.{'cylinder' if self.axes[axis].cylinder is not None else 'joint'}"

    def axis(self, name: str) -> AxisSettings:
        return self.axes[name]

    def recording(self, name: str) -> RecordingSettings:
        for recording in self.recordings:
            if recording.name == name:
                return recording
        raise SettingsError(f"recipe {self.name}", f"no recording {name!r}", nearest(name, [r.name for r in self.recordings]))
