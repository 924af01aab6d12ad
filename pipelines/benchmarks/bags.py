"""ROS 2 bags for the readers: joint states and poses of any number, and large messages that are not mapped.

Messages are encoded by NumPy, many at once: a log of gigabytes is written as fast as the disk takes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType, Writer

JOINTS = ("slew", "boom", "stick", "telescope", "gripper")
RATE = 100.0
START_NS = 1_760_000_000 * 10**9
#: Chunk size of ROS 2's own recorder.
CHUNK = 768 * 1024
#: Messages encoded together.
_BATCH = 20_000

_LINE = "=" * 80
_HEADER = f"""
{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort" + _HEADER
POSE = f"""std_msgs/Header header
geometry_msgs/Pose pose
{_LINE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{_LINE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{_LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w{_HEADER}"""
IMAGE = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data"
    + _HEADER
)


@dataclass(frozen=True)
class Bag:
    """What a bag holds.

    Args:
        states: JointState messages of :data:`JOINTS` with position, velocity, and effort; 100 a second.
        poses: PoseStamped messages, 100 a second.
        images: Image messages, evenly between the others.
        image_bytes: size of one of them.
        compression: of the chunks.
    """

    states: int
    poses: int = 0
    images: int = 0
    image_bytes: int = 2**20
    compression: CompressionType = CompressionType.ZSTD

    @property
    def messages(self) -> int:
        return self.states + self.poses + self.images


def write_bag(path: Path, bag: Bag) -> Path:
    """Write ``bag`` with reproducible content."""
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 256, bag.image_bytes, dtype=np.uint8).tobytes()
    rows = max(bag.states, bag.poses, 1)
    every = max(1, rows // bag.images) if bag.images else 0
    shown = 0
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK, compression=bag.compression)
        writer.start("ros2", "sysid benchmark")
        state = _channel(writer, "/joint_states", "sensor_msgs/msg/JointState", JOINT_STATE)
        pose = _channel(writer, "/pose", "geometry_msgs/msg/PoseStamped", POSE)
        image = _channel(writer, "/camera", "sensor_msgs/msg/Image", IMAGE)
        for begin in range(0, rows, _BATCH):
            t = np.arange(begin, min(begin + _BATCH, rows)) / RATE
            states, poses = _encode_states(t, rng), _encode_poses(t, rng)
            stamps = (START_NS + np.rint(t * 1e9)).astype(np.int64).tolist()
            for offset, stamp in enumerate(stamps):
                row, logged = begin + offset, stamp + 1_200_000
                if row < bag.states:
                    writer.add_message(state, logged, states[offset], logged, row)
                if row < bag.poses:
                    writer.add_message(pose, logged, poses[offset], logged, row)
                if every and row % every == 0 and shown < bag.images:
                    writer.add_message(image, logged, _image(stamp, picture), logged, shown)
                    shown += 1
        writer.finish()
    return path


def _channel(writer: Writer, topic: str, kind: str, definition: str) -> int:
    return int(writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", definition.encode())))


def _text(message: bytes, text: str) -> bytes:
    """``message`` and a string behind it."""
    return _aligned(message, 4) + (len(text) + 1).to_bytes(4, "little") + text.encode() + b"\0"


def _aligned(message: bytes, size: int) -> bytes:
    return message + bytes(-(len(message) - 4) % size)


def _head(frame: str) -> bytes:
    """Encapsulation, room for a stamp, name of the frame."""
    return _text(b"\0\1\0\0" + bytes(8), frame)


def _records(template: bytes, fields: dict[str, tuple[str, int]], t: npt.NDArray[np.float64]) -> npt.NDArray[np.void]:
    """One copy of ``template`` for each stamp, and its numbers by name."""
    places = {"sec": ("<i4", 4), "nanosec": ("<u4", 8), **fields}
    kinds = np.dtype(
        {
            "names": list(places),
            "formats": [kind for kind, _ in places.values()],
            "offsets": [at for _, at in places.values()],
            "itemsize": len(template),
        }
    )
    records = np.frombuffer(bytearray(template * len(t)), kinds)
    stamps = START_NS + np.rint(t * 1e9).astype(np.int64)
    records["sec"], records["nanosec"] = stamps // 10**9, stamps % 10**9
    return records


def _messages(records: npt.NDArray[np.void]) -> list[bytes]:
    whole, size = records.tobytes(), records.itemsize
    return [whole[at : at + size] for at in range(0, len(whole), size)]


def _encode_states(t: npt.NDArray[np.float64], rng: np.random.Generator) -> list[bytes]:
    count = len(JOINTS)
    template = _aligned(_head("base_link"), 4) + count.to_bytes(4, "little")
    for joint in JOINTS:
        template = _text(template, joint)
    fields = {}
    for name in ("position", "velocity", "effort"):
        template = _aligned(_aligned(template, 4) + count.to_bytes(4, "little"), 8)
        fields[name] = (f"{count}<f8", len(template))
        template += bytes(8 * count)
    records = _records(template, fields, t)
    phase = 0.2 * np.pi * np.outer(t, np.arange(1, count + 1))
    records["position"] = np.sin(phase) + 1e-4 * rng.standard_normal(phase.shape)
    records["velocity"] = np.cos(phase) + 1e-3 * rng.standard_normal(phase.shape)
    records["effort"] = 100.0 * np.sin(phase + 0.5) + rng.standard_normal(phase.shape)
    return _messages(records)


def _encode_poses(t: npt.NDArray[np.float64], rng: np.random.Generator) -> list[bytes]:
    template = _aligned(_head("map"), 8)
    records = _records(template + bytes(56), {"pose": ("7<f8", len(template))}, t)
    yaw = 0.3 * np.sin(0.5 * t)
    records["pose"][:, :3] = np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], axis=1) + 1e-4 * rng.standard_normal((len(t), 3))
    records["pose"][:, 5], records["pose"][:, 6] = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
    return _messages(records)


def _image(stamp: int, picture: bytes) -> bytes:
    width = 1024
    head = bytearray(_aligned(_head("camera"), 4) + (len(picture) // width).to_bytes(4, "little") + width.to_bytes(4, "little"))
    head[4:8], head[8:12] = (stamp // 10**9).to_bytes(4, "little"), (stamp % 10**9).to_bytes(4, "little")
    pixels = _aligned(_text(bytes(head), "mono8") + b"\0", 4) + width.to_bytes(4, "little")
    return pixels + len(picture).to_bytes(4, "little") + picture
