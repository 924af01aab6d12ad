"""Export of networks as ONNX files, with a parity check by ONNX Runtime."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError, StorageError, StoreError
from sysid.extras import install_remedy
from sysid.files import json_text
from sysid.networks import (
    ForwardNetwork,
    Mlp,
    Model,
    MotionNetwork,
    StructuredForward,
    history_networks,
    motion_networks,
    static_networks,
)
from sysid.networks.policy import PolicyNetwork
from sysid.signals import axis_signal, point_signals
from sysid.versions.onnx_graph import IR_VERSION, OPSET, Graph

Array = npt.NDArray[np.float64]
Precision = Literal["float32", "float64"]

#: Largest difference of a prediction, relative to the largest value of its output: 32 roundings in float32.
SHARES: dict[Precision, float] = {"float32": 32.0 * 2.0**-23, "float64": 1e-9}
#: Number of compared points inside the fitted range, and as many up to half its width beyond it on either side.
POINTS, BEYOND = 4096, 0.5


@dataclass(frozen=True)
class ExportedFile:
    """One ONNX file and its agreement with the version.

    Args:
        file: its path.
        inputs, outputs: columns of its input and output tensor [SI].
        low, high: fitted range of each input.
        largest: largest difference from the version's own prediction [SI], inside and beyond the fitted range, by output.
        allowed: largest accepted difference [SI], by output.
    """

    file: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    largest: tuple[float, ...]
    allowed: tuple[float, ...]
    points: int
    precision: Precision


@dataclass(frozen=True)
class _OnnxSource:
    """Content of one file: ``put`` adds its nodes to a graph, ``predict`` gives the expected outputs."""

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    low: Array
    high: Array
    put: Callable[[Graph, str], str]
    predict: Callable[[Array], Array]


def export_onnx(
    model: Model | PolicyNetwork,
    folder: Path,
    about: Mapping[str, str] | None = None,
    precision: Precision = "float32",
) -> tuple[ExportedFile, ...]:
    """Write a network as ONNX files into ``folder``, all or none: ``forward.onnx``, ``policy.onnx``, ``boom.to_joint.onnx`` …

    ONNX Runtime evaluates every file on random inputs inside and beyond the fitted range; if a prediction differs from the
    network's by more than rounding, nothing is written.

    Args:
        folder: must not exist, or be an earlier export.
        about: metadata of the files (``reference``, ``digest``).

    Raises:
        SettingsError: onnx or onnxruntime are not installed; the folder has other content; a network with history.
        StoreError: a file predicts other values.
        StorageError: the disk is full, or may not be written.
    """
    runtime = _runtime()
    if folder.exists() and not (folder / "export.json").is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise SettingsError(f"--out {folder}", "exists and is not an export", "a new folder")
    found, contents = [], {}
    for part in _parts(model):
        content = _content(part, precision, about or {})
        exported = _compared(part, content, precision, runtime)
        found.append(exported)
        contents[exported.file] = content
    described = {"schema": 1, **(about or {}), "files": [asdict(entry) for entry in found]}
    contents["export.json"] = json_text(described).encode("utf-8")
    _write(folder, contents)
    return tuple(found)


def _runtime() -> Any:
    try:
        import onnx  # noqa: F401
        import onnxruntime
    except ImportError as error:
        raise SettingsError(
            "sysid models export", f"{error.name} is not installed", "the extra", install_remedy("onnx")
        ) from None
    return onnxruntime


def _parts(model: Model | PolicyNetwork) -> list[_OnnxSource]:
    if isinstance(model, PolicyNetwork):
        low, high = _ends(model.mlp, 1.0)
        return [
            _OnnxSource("policy", model.inputs, model.outputs, low, high, lambda graph, o: graph.policy(model, o), model.act)
        ]
    if isinstance(model, ForwardNetwork | StructuredForward):
        outputs = point_signals("ee")
        return [
            _OnnxSource(
                "forward", model.joints, outputs, model.low, model.high, lambda graph, q: graph.forward(model, q), model.predict
            )
        ]
    if history_networks(model):
        expected = "networks without a state"
        remedy = "Export actuator networks without history, or step it in Python."
        raise SettingsError("sysid models export", "actuator networks with history", expected, remedy)
    found = [_motion(axis, network) for axis, network in motion_networks(model).items()]
    for axis, network in static_networks(model).items():
        cylinder, joint = axis_signal(axis, "cylinder"), axis_signal(axis, "joint")
        found.append(_static(f"{axis}.to_joint", cylinder, joint, network.displacements, network.to_joint))
        found.append(_static(f"{axis}.to_cylinder", joint, cylinder, network.joints, network.to_cylinder))
    return found


def _motion(axis: str, network: MotionNetwork) -> _OnnxSource:
    """The speed of the next step."""
    return _OnnxSource(
        f"{axis}.motion",
        network.window.names(network.command, network.driven),
        (f"speed of {network.driven}",),
        *_ends(network.members[0], 2.0),
        lambda graph, value: graph.mean([graph.mlp(mlp, value) for mlp in network.members]),
        lambda values: network.speed(values)[:, None],
    )


def _static(name: str, source: str, output: str, ends: tuple[float, float], mlp: Mlp) -> _OnnxSource:
    low, high = np.array(ends)[:, None]
    return _OnnxSource(name, (source,), (output,), low, high, lambda graph, value: graph.mlp(mlp, value), mlp.predict)


def _ends(mlp: Mlp, deviations: float) -> tuple[Array, Array]:
    """Means of its inputs ∓ so many standard deviations."""
    return mlp.inputs.mean - deviations * mlp.inputs.scale, mlp.inputs.mean + deviations * mlp.inputs.scale


def _content(part: _OnnxSource, precision: Precision, about: Mapping[str, str]) -> bytes:
    """The file, verified by ``onnx.checker``."""
    import onnx
    from onnx import TensorProto, helper

    graph = Graph(np.float32 if precision == "float32" else np.float64)
    kind = TensorProto.FLOAT if precision == "float32" else TensorProto.DOUBLE
    graph.add("Identity", part.put(graph, "inputs"), output="outputs")
    whole = helper.make_graph(
        graph.nodes,
        part.name,
        [helper.make_tensor_value_info("inputs", kind, ["n", len(part.inputs)])],
        [helper.make_tensor_value_info("outputs", kind, ["n", len(part.outputs)])],
        graph.constants,
        doc_string=f"{', '.join(part.inputs)} → {', '.join(part.outputs)}, in m and rad",
    )
    file = helper.make_model(
        whole, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="sysid"
    )
    facts = {"inputs": list(part.inputs), "outputs": list(part.outputs), "low": part.low.tolist(), "high": part.high.tolist()}
    helper.set_model_props(file, {**about, **{key: json.dumps(value) for key, value in facts.items()}})
    onnx.checker.check_model(file, full_check=True)
    return bytes(file.SerializeToString())


def _compared(part: _OnnxSource, content: bytes, precision: Precision, runtime: Any) -> ExportedFile:
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    dtype = np.float32 if precision == "float32" else np.float64
    share = np.random.default_rng(0).uniform(0.0, 1.0, (2 * POINTS, len(part.inputs)))
    share[POINTS:] = share[POINTS:] * (1.0 + 2.0 * BEYOND) - BEYOND
    points = (part.low + share * (part.high - part.low)).astype(dtype)
    # Both sides get the rounded inputs.
    own = part.predict(points.astype(np.float64))
    try:
        session = runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        predicted = np.asarray(session.run(None, {"inputs": points})[0], dtype=np.float64)
    except Exception as error:  # the runtime's errors have no common base class
        found = f"cannot be run ({str(error).splitlines()[0]})"
        raise StoreError(f"ONNX of {part.name}", found, "a file that ONNX Runtime runs") from None
    if predicted.shape != own.shape:
        raise StoreError(f"ONNX of {part.name}", f"shape {predicted.shape}", f"{own.shape}")
    largest = np.abs(predicted - own).max(axis=0)
    allowed = SHARES[precision] * np.abs(own).max(axis=0)
    for name, difference, most in zip(part.outputs, largest, allowed, strict=True):
        if not difference <= most:  # NaN fails as well
            remedy = "Export it with --precision float64." if precision == "float32" else ""
            found = f"{name} differs by {difference:.3g} from the version itself"
            raise StoreError(f"ONNX of {part.name}", found, f"at most {most:.3g} (rounding of {precision})", remedy)
    return ExportedFile(
        file=f"{part.name}.onnx",
        inputs=part.inputs,
        outputs=part.outputs,
        low=tuple(part.low.tolist()),
        high=tuple(part.high.tolist()),
        largest=tuple(largest.tolist()),
        allowed=tuple(allowed.tolist()),
        points=len(points),
        precision=precision,
    )


def _write(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write all files or none: into a temporary folder that is then renamed."""
    half = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        half = Path(tempfile.mkdtemp(prefix=".partial-", dir=folder.parent))
        half.chmod(0o755)
        for name, content in contents.items():
            (half / name).write_bytes(content)
        if folder.exists():
            shutil.rmtree(folder)
        half.rename(folder)
    except OSError as error:
        found = f"cannot be written ({error.strerror or error}); nothing was exported"
        raise StorageError(folder, found, remedy="Make room, or name another folder with --out.") from None
    finally:
        if half is not None:
            shutil.rmtree(half, ignore_errors=True)
