"""Every drafted recipe is ingested as it is: bags of every kind and LeRobot datasets with names, units and stamps at random."""

from __future__ import annotations

import json
import random
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as RawWriter
from mcap_ros2.writer import Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from sysid.datasets import Store, ingest

JOINTS = "sensor_msgs/msg/JointState"
DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
AXES = ("boom", "stick", "slew")
TOPICS = ("/cmd", "/joint_states", "/valves/command", "/goal", "/draw_wires", "/boom/state", "/servo/present", "/js", "/arm")


@dataclass
class Log:
    """Topics with rows of (stamp of the recorder [s], stamp of the header [s], name → value)."""

    topics: dict[str, list[tuple[float, float, dict[str, float]]]] = field(default_factory=dict)


def drawn(rng: random.Random, begin: float) -> Log:
    log = Log()
    for topic in rng.sample(TOPICS, rng.randint(1, 4)):
        names = [*rng.sample(AXES, rng.randint(1, 3)), *rng.choice(([], ["other"], ["boom_2"]))]
        still, offset, delay = rng.random() < 0.15, rng.choice((0.0, 0.0, 40.0)), rng.choice((0.0, 0.004))
        stamped, rate = rng.random() < 0.7, rng.choice((20.0, 50.0))
        rows = []
        for k in range(int(rate * 12)):
            t = k / rate
            values = {name: offset + (0.0 if still else float(np.sin(t + n))) for n, name in enumerate(names)}
            if rng.random() < 0.1:
                values = dict(reversed(values.items()))
            rows.append((begin + t + delay, begin + t if stamped else 0.0, values))
        log.topics[topic] = rows
    return log


def stamp(seconds: float) -> dict[str, int]:
    whole = int(1e9 * seconds)
    return {"sec": whole // 10**9, "nanosec": whole % 10**9}


def messages(log: Log) -> list[tuple[int, str, float, dict[str, float]]]:
    rows = [(int(1e9 * at), topic, header, values) for topic, own in log.topics.items() for at, header, values in own]
    return sorted(rows, key=lambda row: row[0])


def cdr(path: Path, log: Log) -> None:
    with path.with_suffix(".mcap").open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef(JOINTS, DEFINITION)
        for at, topic, header, values in messages(log):
            message = {"header": {"stamp": stamp(header), "frame_id": ""}, "name": [*values], "position": [*values.values()]}
            message |= {"velocity": [v / 2 for v in values.values()], "effort": []}
            writer.write_message(topic, schema, message, log_time=at, publish_time=at)


def as_json(path: Path, log: Log) -> None:
    with path.with_suffix(".mcap").open("wb") as file:
        writer = RawWriter(file)
        writer.start()
        channels = {topic: writer.register_channel(topic, "json", 0) for topic in log.topics}
        for at, topic, header, values in messages(log):
            body: dict[str, Any] = {"bodies": [{"name": name, "angle": value} for name, value in values.items()]}
            body |= {"header": {"stamp": stamp(header)}, **{f"{name} cmd": value for name, value in values.items()}}
            writer.add_message(channels[topic], at, json.dumps(body).encode(), at)
        writer.finish()


def in_store(store: Any, header: float, values: dict[str, float]) -> Any:
    types = store.types
    when = types["builtin_interfaces/msg/Time"](**stamp(header))
    extra = {"seq": 0} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
    numbers = np.array([*values.values()])
    head = types["std_msgs/msg/Header"](**extra, stamp=when, frame_id="")
    return types[JOINTS](header=head, name=[*values], position=numbers, velocity=numbers / 2, effort=numbers[:0])


def ros1(path: Path, log: Log) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path.with_suffix(".bag")) as writer:
        connections = {topic: writer.add_connection(topic, JOINTS, typestore=store) for topic in log.topics}
        for at, topic, header, values in messages(log):
            writer.write(connections[topic], at, store.serialize_ros1(in_store(store, header, values), JOINTS))


def rosbag2(path: Path, log: Log) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(path.with_suffix(".made"), version=9) as writer:
        connections = {topic: writer.add_connection(topic, JOINTS, typestore=store) for topic in log.topics}
        for at, topic, header, values in messages(log):
            writer.write(connections[topic], at, store.serialize_cdr(in_store(store, header, values), JOINTS))
    (made,) = path.with_suffix(".made").glob("*.db3")
    made.rename(path.with_suffix(".db3"))
    shutil.rmtree(path.with_suffix(".made"))


def machine(rng: random.Random) -> str:
    text = 'schema = 1\nname = "rig"\nrate_hz = 20.0\n'
    for name in AXES:
        actuation, drives = rng.choice((("velocity", "joint"), ("velocity", "cylinder"), ("position", "joint")))
        stroke = "stroke = [0.0, 1.0]\n" if drives == "cylinder" else ""
        text += f'[[axes]]\nname = "{name}"\nactuation = "{actuation}"\ndrives = "{drives}"\n{stroke}'
    return text


@pytest.mark.parametrize("write", [cdr, as_json, ros1, rosbag2])
@settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), places=st.sampled_from([("a/x",), ("x_0", "x_1"), ("a/x", "b/x"), ("a/x", "a/y")]))
def test_a_draft_is_ingested_as_it_is(
    tmp_path: Path, write: Callable[[Path, Log], None], seed: int, places: tuple[str, ...]
) -> None:
    rng = random.Random(seed)
    folder = tmp_path / f"{len(list(tmp_path.iterdir()))}"
    for number, place in enumerate(places):
        (folder / "logs" / place).parent.mkdir(parents=True, exist_ok=True)
        write(folder / "logs" / place, drawn(rng, 1.7e9 + 100.0 * number))
    (folder / "machine.toml").write_text(machine(rng))
    draft = folder / "recipe.toml"
    assert run("ingest", "--inspect", folder / "logs", "--draft", draft) == 0
    recipe = tomllib.loads(draft.read_text("utf-8"))
    named = [stream for stream in recipe["streams"] if stream.get("signals")]
    if len(named) == len(recipe["streams"]):
        assert run("--workspace", folder / "ws", "ingest", folder / "logs", "--recipe", draft) == 0, draft.read_text("utf-8")
        found = {str(column) for recording in Store(folder / "ws").load("rig").recordings for column in recording.table.columns}
        assert {signal for stream in named for signal in stream["signals"]} <= found


def test_clocks_that_are_mixed_are_said(tmp_path: Path) -> None:
    """Without `clock` each topic has its first clock: header stamps where they are set, else those of the recorder."""
    times = [5.0 + k / 50.0 for k in range(900)]
    rows = {stamped: [(t, t if stamped else 0.0, {"boom": float(np.sin(t))}) for t in times] for stamped in (True, False)}
    (tmp_path / "rec").mkdir()
    as_json(tmp_path / "rec/log", Log({"/a": rows[True], "/b": rows[False]}))
    axis = '[[axes]]\nname = "boom"\nactuation = "velocity"\ndrives = "joint"\n'
    (tmp_path / "machine.toml").write_text(f'schema = 1\nname = "rig"\nrate_hz = 20.0\n{axis}')
    for clock in ("", 'clock = "log"\n'):
        entries = '"boom.command" = { topic = "/a", field = "boom cmd" }\n'
        entries += '"boom.joint" = { topic = "/b", field = "bodies[boom].angle" }\n'
        (tmp_path / "recipe.toml").write_text(f'schema = 1\n[[streams]]\nfiles = "*"\n{clock}[streams.signals]\n{entries}')
        (source,) = ingest([tmp_path], tmp_path / "ws").sources
        mixed = "header stamps of /a; log stamps of /b are taken as one clock: state `clock` in the recipe to have one of them"
        assert (mixed in source.losses) == (not clock)
