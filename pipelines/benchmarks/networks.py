"""Rows of the networks: the paper's whole set trained at once, compared with the usual methods, and one prediction.

The set: both actuator networks, both directions, and the forward network, five folds of five members each: 125 networks. Beside
it stands the loop that everybody writes, one network after the other, with the same initial weights, rows, updates and rates.
"""

from __future__ import annotations

import functools
import itertools
import json
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import against_limit, in_process, row, seconds
from sysid.networks import (
    Calibration,
    EnsembleMember,
    ForwardNetwork,
    Geometry,
    Mlp,
    Normalisation,
    StructuredForward,
    TrainedMember,
    TrainingSettings,
    fit_chain,
    train,
)

Array = npt.NDArray[np.float64]

FOLDS, MEMBERS, ROWS, POSES = 5, 5, 1500, 500
RATE = 1e-3
#: Rows of an update → epochs: few, so that all of it takes two minutes on cores of its own.
EPOCHS = {32: 3, 64: 4, 256: 6, 1024: 6}
REPEATS = 3
#: Epochs for the comparison with scikit-learn; more gain little.
PEER_EPOCHS, PEER_BATCH = 30, 64
#: Goal of one prediction [µs].
PREDICT_LIMIT = 50.0
LAYERS = {"boom": (256, 128, 128), "stick": (128, 128), "forward": (256, 128)}
NOISE_JOINT, NOISE_CYLINDER, NOISE_TIP = 1e-3, 6e-5, 3e-4


def paper_set(members: int = MEMBERS) -> list[EnsembleMember]:
    """All networks, with rows of the shipped crane: its drawn linkages and its kinematics, with the noise of its sensors."""
    from benchmarks.crane import crane

    plant, rng, found = crane(), np.random.default_rng(0), []
    machine = plant.machine
    for axis in machine.axes:
        if axis.name not in plant.linkages:
            continue
        linkage = plant.linkages[axis.name]
        low, high = axis.range
        cylinder = rng.uniform(low, high, ROWS)
        columns = {
            "cylinder": (cylinder + rng.normal(0.0, NOISE_CYLINDER, ROWS))[:, None],
            "joint": (linkage.joint(cylinder) + rng.normal(0.0, NOISE_JOINT, ROWS))[:, None],
        }
        for source, target in (("cylinder", "joint"), ("joint", "cylinder")):
            found += _folds(f"{axis.name} to_{target}", columns[source], columns[target], LAYERS[axis.name], members)
    kinematics = machine.kinematics()
    assert kinematics is not None
    joints = np.column_stack([rng.uniform(*(axis.limits or (0.0, 0.0)), POSES) for axis in machine.axes])
    tip = kinematics.tip_position(joints) + rng.normal(0.0, NOISE_TIP, (POSES, 3))
    return found + _folds("forward", joints, tip, LAYERS["forward"], members)


def _folds(name: str, x: Array, y: Array, hidden: tuple[int, ...], members: int) -> list[EnsembleMember]:
    from sklearn.model_selection import KFold

    names = [tuple(f"{side} {k}" for k in range(values.shape[1])) for side, values in (("input", x), ("output", y))]
    return [
        EnsembleMember(f"{name} fold {fold} member {number}", x[fit], y[fit], x[held], y[held], names[0], names[1], hidden)
        for fold, (fit, held) in enumerate(KFold(FOLDS, shuffle=True, random_state=0).split(x))
        for number in range(members)
    ]


def plain(members: Sequence[EnsembleMember], batch: int, epochs: int) -> tuple[list[Array], int]:
    """One network after the other in PyTorch as its tutorials have it; residuals on the held-out rows, and updates made."""
    import torch

    from sysid.networks.batch import unpack
    from sysid.networks.jobs import ShuffleOrder, initial_row

    residuals, updates = [], 0
    for member in members:
        assert member.hidden
        sizes = (member.inputs.shape[1], *member.hidden, member.outputs.shape[1])
        layers: list[torch.nn.Module] = []
        for weight, bias in zip(*unpack(sizes, initial_row(0, member.name, sizes)), strict=True):
            linear = torch.nn.Linear(*weight.shape)
            linear.load_state_dict({"weight": torch.tensor(weight.T), "bias": torch.tensor(bias)})
            layers += [linear, torch.nn.ReLU()]
        net, loss = torch.nn.Sequential(*layers[:-1]), torch.nn.MSELoss()
        optimiser = torch.optim.Adam(net.parameters(), lr=RATE)
        inputs, outputs = (
            Normalisation.of(values, names, member.name)
            for values, names in ((member.inputs, member.input_names), (member.outputs, member.output_names))
        )
        x, y = (
            torch.tensor(scaler.apply(values), dtype=torch.float32)
            for scaler, values in ((inputs, member.inputs), (outputs, member.outputs))
        )
        width, order = min(batch, len(x)), ShuffleOrder(0, member.name, len(x))
        steps = -(-epochs * len(x) // width)
        rows = torch.from_numpy(order.take(0, steps * width))
        for step in range(steps):
            chosen = rows[step * width : (step + 1) * width]
            optimiser.zero_grad()
            loss(net(x[chosen]), y[chosen]).backward()
            optimiser.step()
        with torch.no_grad():
            said = net(torch.tensor(inputs.apply(member.validation_inputs), dtype=torch.float32)).numpy()
        residuals.append(outputs.invert(said) - member.validation_outputs)
        updates += steps
    return residuals, updates


def ours(members: Sequence[EnsembleMember], batch: int, epochs: int) -> tuple[TrainedMember, ...]:
    """The same at once, with an evaluation on the held-out rows at the end."""
    settings = TrainingSettings(RATE, batch, epochs, patience=epochs, check_every=epochs, threads=2, device="cpu")
    return train(members, (1,), settings, 0)


def left_by(members: Sequence[EnsembleMember], trained: Sequence[TrainedMember]) -> list[Array]:
    """Residuals on the held-out rows."""
    return [one.mlp.predict(m.validation_inputs) - m.validation_outputs for one, m in zip(trained, members, strict=True)]


def mean_error(members: Sequence[EnsembleMember], residuals: Sequence[Array]) -> float:
    """RMS on held-out rows over all networks, in standard deviations of what they predict."""
    each = [np.mean((left / m.outputs.std(axis=0)) ** 2) for m, left in zip(members, residuals, strict=True)]
    return float(np.sqrt(np.mean(each)))


def faster_threads(work: Callable[[], object], set_threads: Callable[[int], object], tries: int = 5) -> int:
    """One thread or two, whichever takes less in turns: two that wait for one another are slower where something else runs."""
    taken = {1: 0.0, 2: 0.0}
    for _ in range(tries):
        for count in taken:
            set_threads(count)
            taken[count] += seconds(work)
    return min(taken, key=lambda count: taken[count])


def loop_rows() -> list[dict[str, Any]]:
    import torch

    members, rows, before = paper_set(), [], torch.get_num_threads()
    for batch, epochs in EPOCHS.items():
        threads = faster_threads(lambda: plain(members[:1], batch, 1), torch.set_num_threads)  # noqa: B023
        taken: dict[str, list[float]] = {"ours": [], "plain": []}
        used: list[float] = []
        ours(members[::5], batch, 1)
        for _ in range(REPEATS):
            torch.set_num_threads(threads)
            begin, busy = time.perf_counter(), time.process_time()
            left, updates = plain(members, batch, epochs)
            between, busy_between = time.perf_counter(), time.process_time()
            mine = ours(members, batch, epochs)
            taken["plain"].append(between - begin)
            taken["ours"].append(time.perf_counter() - between)
            used.append((busy_between - busy) / (time.process_time() - busy_between))
        torch.set_num_threads(before)
        errors = mean_error(members, left_by(members, mine)), mean_error(members, left)
        note = (
            f"{len(members)} networks (both actuators, both directions, forward; {FOLDS} folds of {MEMBERS}), "
            f"{updates} updates of {batch} rows at most, two cores; RMS held out "
            f"{errors[0]:.5f} and {errors[1]:.5f} standard deviations; the loop with {threads} thread(s), the faster of one "
            f"and two; processor time {statistics.median(used):.2f} times less"
        )
        rows.append(row(f"train_batch_{batch}", "PyTorch loop", taken["ours"], taken["plain"], "s", note))
    return rows


def scikit_rows() -> list[dict[str, Any]]:
    """Five folds of each network that goes one way, for as many epochs."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPRegressor
    from threadpoolctl import threadpool_limits

    members = [member for member in paper_set(1) if "to_cylinder" not in member.name]

    def theirs(some: Sequence[EnsembleMember], epochs: int = PEER_EPOCHS) -> list[Array]:
        residuals = []
        for member in some:
            inputs, outputs = (Normalisation.of(v, ("",) * v.shape[1], "") for v in (member.inputs, member.outputs))
            model = MLPRegressor(
                hidden_layer_sizes=member.hidden, learning_rate_init=RATE, batch_size=PEER_BATCH, max_iter=epochs,
                alpha=0.0, tol=0.0, n_iter_no_change=epochs, random_state=0,
            )  # fmt: skip
            target = outputs.apply(member.outputs)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ConvergenceWarning)
                model.fit(inputs.apply(member.inputs), target[:, 0] if target.shape[1] == 1 else target)
            said = model.predict(inputs.apply(member.validation_inputs)).reshape(member.validation_outputs.shape)
            residuals.append(outputs.invert(said) - member.validation_outputs)
        return residuals

    def limited(count: int) -> None:
        threadpool_limits(count, "blas")

    with threadpool_limits(None):
        threads = faster_threads(lambda: theirs(members[:1], 3), limited)
        limited(threads)
        taken: dict[str, list[float]] = {"ours": [], "scikit": []}
        for _ in range(REPEATS):
            begin = time.perf_counter()
            left = theirs(members)
            between = time.perf_counter()
            mine = ours(members, PEER_BATCH, PEER_EPOCHS)
            taken["scikit"].append(between - begin)
            taken["ours"].append(time.perf_counter() - between)
    errors = mean_error(members, left_by(members, mine)), mean_error(members, left)
    note = (
        f"{len(members)} networks (boom and stick to joint, forward; {FOLDS} folds), {PEER_EPOCHS} epochs of "
        f"{PEER_BATCH} rows an update, the same learning rate; RMS held out {errors[0]:.4f} and {errors[1]:.4f} standard "
        f"deviations; {threads} BLAS thread(s), the faster of one and two"
    )
    return [row("train_folds", "MLPRegressor", taken["ours"], taken["scikit"], "s", note)]


def predict_rows() -> list[dict[str, Any]]:
    """One sample at a time, in a process that has not loaded torch."""
    found: dict[str, list[float]] = in_process(Path(__file__), "predict")
    note = "one sample, SI in, SI out, torch not loaded; the faster half of the repeats, since the others waited"
    return [against_limit(f"predict_{name}", times, PREDICT_LIMIT, "µs", note) for name, times in found.items()]


def predictions(calls: int = 500, repeats: int = 21) -> dict[str, list[float]]:
    """Times of one prediction [µs]."""
    from benchmarks.crane import crane

    rng = np.random.default_rng(0)

    def perceptron(d_in: int, hidden: Sequence[int], d_out: int) -> Mlp:
        sizes = (d_in, *hidden, d_out)
        weights = tuple(rng.normal(size=(a, b)) / np.sqrt(a) for a, b in itertools.pairwise(sizes))
        scalers = (Normalisation(rng.normal(size=d), rng.uniform(1.0, 2.0, d)) for d in (d_in, d_out))
        return Mlp(weights, tuple(np.zeros(b) for b in sizes[1:]), *scalers)

    kinematics, joints, angles = crane().machine.kinematics(), tuple("abcd"), (True, True, True, False)
    assert kinematics is not None
    poses = rng.uniform(-1.0, 1.0, (POSES, 4))
    common: dict[str, Any] = {"joints": joints, "revolute": angles, "low": np.zeros(4), "high": np.ones(4)}
    geometry = Geometry(kinematics)
    count = len(geometry.parameters)
    calibrated = Calibration(geometry, rng.normal(0.0, 1e-3, count) * ~geometry.elastic, np.eye(count), 1e-3, ())
    chain = fit_chain(poses, kinematics.tip_position(poses), angles)
    rest: dict[str, Any] = {"members": (perceptron(7, (32, 32), 3),), "urdf": "", "bound": 0.01}
    models: dict[str, tuple[Any, int]] = {
        "boom": (perceptron(1, LAYERS["boom"], 1), 1),
        "stick": (perceptron(1, LAYERS["stick"], 1), 1),
        "forward": (ForwardNetwork(**common, features="joints", members=(perceptron(4, LAYERS["forward"], 3),)), 4),
        "forward_structured": (StructuredForward(**common, **rest, structure=calibrated), 4),
        "forward_chain": (StructuredForward(**common, **rest, structure=chain), 4),
    }
    works: dict[str, Callable[[], object]] = {}
    for name, (model, d_in) in models.items():
        works[name] = functools.partial(model.predict, rng.uniform(-1.0, 1.0, (1, d_in)))
    found = {}
    for name, work in works.items():
        times = [seconds(lambda: [work() for _ in range(calls)]) / calls * 1e6 for _ in range(repeats)]  # noqa: B023
        found[name] = sorted(times)[: repeats // 2 + 1]  # the slower half has waited for other programs
    if "torch" in sys.modules:
        raise SystemExit("torch was loaded to predict")
    return found


def network_rows() -> list[dict[str, Any]]:
    """Every row of the networks."""
    return [*loop_rows(), *scikit_rows(), *predict_rows()]


if __name__ == "__main__":
    print(json.dumps(predictions()))
