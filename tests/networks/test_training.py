"""The engine: right gradients, members that do not disturb each other, the same seed the same network."""

from __future__ import annotations

import itertools
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

from sysid.errors import ExcitationError, InputError, SettingsError
from sysid.networks import EnsembleMember, Mlp, Normalisation, TrainedMember, TrainingSettings, train
from sysid.networks.batch import BatchedAdam, BatchedMlp, Stack, pack, padded, unpack
from sysid.networks.jobs import ShuffleOrder, batches, initial_row, job_of, layers_of, scalers_of
from sysid.networks.mlp import Rectifier

QUICK = TrainingSettings(learning_rate=1e-2, batch=32, epochs=60, patience=60)


def member(name: str = "m", seed: int = 0, noise: float = 0.0, rows: int = 256) -> EnsembleMember:
    """``y = (sin 2x₀ + x₁, x₀ x₁)`` in units of a few thousand and an offset, which normalisation has to take care of."""
    rng = np.random.default_rng(seed)
    x, v = rng.uniform(-1, 1, (rows, 2)), rng.uniform(-1, 1, (128, 2))

    def y(inputs: np.ndarray) -> np.ndarray:
        values = np.column_stack([np.sin(2 * inputs[:, 0]) + inputs[:, 1], inputs[:, 0] * inputs[:, 1]])
        return 5e3 + 1e3 * (values + rng.normal(0, noise, values.shape) if noise else values)

    return EnsembleMember(name, x, y(x), v, y(v), ("a", "b"), ("c", "d"))


def misled(name: str, seed: int) -> EnsembleMember:
    """Its validation rows follow another law: learning more about the rows to fit soon makes it worse."""
    one = member(name, seed)
    return replace(one, validation_outputs=one.validation_outputs[::-1].copy())


def same(first: TrainedMember, second: TrainedMember, rtol: float = 0.0) -> bool:
    pairs = zip((*first.mlp.weights, *first.mlp.biases), (*second.mlp.weights, *second.mlp.biases), strict=True)
    return all(np.allclose(a, b, rtol=rtol, atol=rtol) for a, b in pairs)


def random_rows(sizes: tuple[int, ...], members: int) -> list[np.ndarray]:
    return [initial_row(0, f"member {k}", sizes) for k in range(members)]


def padded_rows(columns: int, *shape: int) -> torch.Tensor:
    rows = torch.zeros(*shape, 8)
    rows[..., :columns] = torch.randn(*shape, columns)
    return rows


def rounded(x: torch.Tensor) -> torch.Tensor:
    return 0.5 * (x + torch.sqrt(x**2 + 4.0)) - 1.0


RECTIFIERS = {"relu": torch.relu, "smooth": rounded}


@pytest.mark.parametrize("rectifier", RECTIFIERS)
def test_the_written_out_gradient_is_that_of_autograd(rectifier: Rectifier) -> None:
    sizes = (3, 12, 5, 2)
    rows = random_rows(sizes, 2)
    model = BatchedMlp.of_rows(padded(sizes), rows, rectifier=rectifier)
    x, y = padded_rows(3, 2, 17), padded_rows(2, 2, 17)
    with torch.no_grad():
        losses = model.accumulate(x, y, torch.full((2, 1, 1), 2.0))
    for k, row in enumerate(rows):
        weights, biases = ([torch.tensor(part, requires_grad=True) for part in parts] for parts in unpack(sizes, row))
        h = x[k, :, :3].double()
        for w, b in zip(weights[:-1], biases[:-1], strict=True):
            h = RECTIFIERS[rectifier](h @ w + b)
        expected = ((h @ weights[-1] + biases[-1] - y[k, :, :2]) ** 2).mean()
        expected.backward()
        torch.testing.assert_close(losses[k].double(), expected.detach(), rtol=1e-5, atol=0.0)
        gradients = [unpack(sizes, model.gradients.row(k))[part] for part in (0, 1)]
        for wanted, found in zip([*weights, *biases], [*gradients[0], *gradients[1]], strict=True):
            np.testing.assert_allclose(found, wanted.grad.numpy(), rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("rectifier", RECTIFIERS)
def test_what_fills_up_a_width_stays_zero(rectifier: Rectifier) -> None:
    sizes = (3, 12, 5, 2)
    model = BatchedMlp.of_rows(padded(sizes), random_rows(sizes, 1), rectifier=rectifier)
    adam = BatchedAdam(Stack.zeros(model.sizes, 1), Stack.zeros(model.sizes, 1), 0)
    with torch.no_grad():
        for _ in range(5):
            model.accumulate(padded_rows(3, 1, 17), padded_rows(2, 1, 17), torch.full((1, 1, 1), 2.0))
            adam.step(model, [1e-2])
    row = model.parameters.row(0)
    np.testing.assert_array_equal(row, pack(sizes, *unpack(sizes, row)))
    assert np.count_nonzero(row) == sum((a + 1) * b for a, b in itertools.pairwise(sizes))


def test_adam_is_that_of_torch_with_a_rate_for_each_member() -> None:
    sizes, rates = (2, 6, 1), [1e-2, 1e-2, 3e-3]
    rows = random_rows(sizes, 3)
    model = BatchedMlp.of_rows(padded(sizes), rows)
    adam = BatchedAdam(Stack.zeros(model.sizes, 3), Stack.zeros(model.sizes, 3), 0)
    alone = [torch.nn.Parameter(torch.from_numpy(row.copy())) for row in rows]
    peers = [torch.optim.Adam([one], lr=rate) for one, rate in zip(alone, rates, strict=True)]
    for _ in range(4):
        with torch.no_grad():
            model.accumulate(padded_rows(2, 3, 16), padded_rows(1, 3, 16), torch.ones(3, 1, 1))
            for k, (one, peer) in enumerate(zip(alone, peers, strict=True)):
                one.grad = torch.from_numpy(model.gradients.row(k))
                peer.step()
            adam.step(model, rates)
    for k, one in enumerate(alone):
        np.testing.assert_allclose(model.parameters.row(k), one.detach().numpy(), rtol=1e-5, atol=1e-8)


def test_every_pass_of_the_order_has_every_row_once_and_any_place_can_be_asked_for() -> None:
    whole = ShuffleOrder(3, "m", 10).take(0, 40)
    assert all(sorted(part) == list(range(10)) for part in whole.reshape(4, 10))
    assert not (whole[:10] == whole[10:20]).all()
    np.testing.assert_array_equal(ShuffleOrder(3, "m", 10).take(17, 34), whole[17:34])
    assert not (ShuffleOrder(4, "m", 10).take(0, 40) == whole).all()


def test_training_recovers_a_known_map() -> None:
    (result,) = train([member()], (32, 32), replace(QUICK, epochs=150), seed=0)
    fresh = member(seed=9)
    error = result.mlp.predict(fresh.inputs) - fresh.outputs
    assert np.sqrt((error**2).mean(axis=0)).max() < 30.0  # of a standard deviation of about 1000
    assert result.mlp.hidden == (32, 32)
    assert result.mlp.parameters == 2 * 32 + 32 + 32 * 32 + 32 + 32 * 2 + 2
    assert result.curve.rows == (256, 128)
    assert result.curve.fit_loss[-1] < 0.1 * result.curve.fit_loss[0]


@pytest.mark.parametrize("rectifier", RECTIFIERS)
def test_numpy_inference_is_that_of_the_weights(rectifier: Rectifier) -> None:
    (result,) = train([replace(member(), rectifier=rectifier)], (8,), replace(QUICK, epochs=5), seed=0)
    mlp, x = result.mlp, member(seed=3).inputs
    by_torch = torch.from_numpy((x - mlp.inputs.mean) / mlp.inputs.scale)
    by_torch = RECTIFIERS[rectifier](by_torch @ torch.from_numpy(mlp.weights[0]) + torch.from_numpy(mlp.biases[0]))
    by_torch = by_torch @ torch.from_numpy(mlp.weights[1]) + torch.from_numpy(mlp.biases[1])
    np.testing.assert_allclose(mlp.predict(x), by_torch.numpy() * mlp.outputs.scale + mlp.outputs.mean, rtol=1e-12)
    np.testing.assert_array_equal(np.isnan(mlp.predict([[0.0, np.nan], [0.0, 0.0]])).any(axis=1), [True, False])
    with pytest.raises(InputError, match=r"shape \(1, 3\); expected \(n, 2\)"):
        mlp.predict([1.0, 2.0, 3.0])


def test_same_seed_same_network_and_another_seed_another() -> None:
    quick = replace(QUICK, epochs=10)
    (first,), (again,), (other,) = (train([member()], (16,), quick, seed) for seed in (7, 7, 8))
    assert same(first, again)
    assert not same(first, other, rtol=1e-3)


def test_a_member_is_trained_as_if_it_were_alone_bit_for_bit() -> None:
    """Unequal rows, columns, learning rates, and members that finish before the others; in batches cut any way."""
    quick = replace(QUICK, epochs=40, patience=5)
    one_column = replace(
        member("narrow"), inputs=member().inputs[:, :1], validation_inputs=member().validation_inputs[:, :1], input_names=("a",)
    )
    members = [
        member("a", 1), member("b", 2, rows=301), member("c", 3, rows=97), replace(member("d", 4), learning_rate=3e-3),
        member("few", 5, rows=20), one_column, replace(member("deep", 6), hidden=(9, 7)), misled("misled", 7), member("e", 8),
        replace(member("smooth", 9, rows=97), rectifier="smooth"), replace(member("smoother", 10), rectifier="smooth"),
    ]  # fmt: skip
    alone = [train([one], (19, 33), quick, 0)[0] for one in members]
    assert len({result.curve.epochs for result in alone}) > 1
    for threads in (1, 3):
        together = train(members, (19, 33), replace(quick, threads=threads), seed=0)
        for first, second in zip(together, alone, strict=True):
            assert same(first, second)
            assert first.curve.to_json() == second.curve.to_json()
    some = train(members[2:5][::-1], (19, 33), quick, seed=0)
    assert all(same(first, second) for first, second in zip(some, alone[2:5][::-1], strict=True))
    assert not same(alone[0], alone[1], rtol=1e-3)


def test_members_of_different_sizes_keep_their_order() -> None:
    members = [member("small", rows=64), member("large"), replace(member("small too", rows=64), hidden=(5, 4))]
    results = train(members, (4,), replace(QUICK, epochs=5), seed=0)
    assert [result.curve.rows[0] for result in results] == [64, 256, 64]
    assert [result.mlp.hidden for result in results] == [(4,), (4,), (5, 4)]


def test_members_that_differ_in_rows_and_rates_share_one_batch() -> None:
    settings = replace(QUICK, schedule="cosine")
    members = [member("a", rows=100), member("b", rows=130), replace(member("c"), learning_rate=1e-3)]
    jobs = [job_of(each, layers_of(each, (8,)), scalers_of(each), settings, 0, "cpu", None) for each in members]
    assert [len(batch) for batch in batches(jobs, 1, torch.device("cpu"))] == [3]
    assert [len(batch) for batch in batches(jobs, 2, torch.device("cpu"))] == [1, 2]


def test_each_member_stops_by_itself_with_its_best_weights() -> None:
    learnable = member("learnable")
    misleading = misled("misleading", 1)
    settings = TrainingSettings(learning_rate=1e-2, batch=32, epochs=120, patience=20)
    first, second = train([learnable, misleading], (32, 32), settings, seed=0)
    assert second.curve.epochs < first.curve.epochs
    assert second.curve.epochs == second.curve.best_epoch + 20
    assert second.curve.checked_epochs[-1] == second.curve.epochs
    best = second.curve.validation_loss.index(min(second.curve.validation_loss))
    assert second.curve.checked_epochs[best] == second.curve.best_epoch
    residual = second.mlp.predict(misleading.validation_inputs) - misleading.validation_outputs
    normalised = ((residual / second.mlp.outputs.scale) ** 2).mean()
    assert normalised == pytest.approx(second.curve.validation_loss[best], rel=1e-3)


def test_cosine_lowers_the_rate_to_a_hundredth(monkeypatch: pytest.MonkeyPatch) -> None:
    rates: list[list[float]] = []
    step = BatchedAdam.step
    monkeypatch.setattr(BatchedAdam, "step", lambda self, model, rate: (rates.append(rate), step(self, model, rate))[1])
    slower = replace(member("slower", rows=64), learning_rate=1e-3)
    train([member(rows=64), slower], (4,), replace(QUICK, epochs=5, schedule="cosine", threads=1), seed=0)
    first, second = np.array(rates).T[::-1]
    assert first[[0, -1]] == pytest.approx([1e-2, 1e-4])
    assert second == pytest.approx(0.1 * first)
    assert list(first) == sorted(first, reverse=True)


def test_progress_is_the_share_of_the_work_reported_in_the_calling_thread() -> None:
    seen: list[tuple[float, str]] = []
    here = threading.get_ident()

    def tell(done: float, text: str) -> None:
        assert threading.get_ident() == here
        seen.append((done, text))

    members = [member("boom to_joint"), replace(member("stick to_joint"), hidden=(12,))]
    train(members, (4,), replace(QUICK, epochs=10, threads=1), 0, tell)
    shares = [done for done, _ in seen]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert 0.0 < shares[0] < 0.5
    assert {text for _, text in seen} == {"boom to_joint", "stick to_joint"}


def test_a_listener_that_raises_ends_the_training() -> None:
    def tell(done: float, text: str) -> None:
        raise KeyboardInterrupt

    began = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        train([member()], (64, 64), replace(QUICK, epochs=100_000), 0, tell)
    assert threading.active_count() == began


def test_threads_are_put_back() -> None:
    before = torch.get_num_threads()
    train([member()], (4,), replace(QUICK, epochs=1, threads=before + 1), 0)
    assert torch.get_num_threads() == before


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there() -> None:
    with pytest.raises(SettingsError, match=r"training: device = 'cuda', which torch does not find; .*Use 'auto' or 'cpu'"):
        train([member()], (4,), replace(QUICK, device="cuda"), 0)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_gpu_trains_the_same_network() -> None:
    quick = replace(QUICK, epochs=5)
    by_cpu, by_gpu = (train([member("a"), member("b", 1)], (32, 32), replace(quick, device=d), 0) for d in ("cpu", "cuda"))
    assert all(same(x, y, rtol=1e-2) for x, y in zip(by_cpu, by_gpu, strict=True))


def with_value(key: str, value: float) -> EnsembleMember:
    values = getattr(member(), key).copy()
    values[3, 0] = value
    return replace(member(), **{key: values})


@pytest.mark.parametrize(
    ("broken", "error", "message"),
    [
        (with_value("inputs", np.nan), InputError, r"network m: inputs: 1 values are NaN or infinite"),
        (with_value("validation_outputs", np.inf), InputError, r"network m: validation_outputs: 1 values are NaN"),
        (replace(member(), inputs=np.ones((256, 2))), ExcitationError, r"network m: a is constant \(1\); expected a signal"),
        (replace(member(), outputs=member().outputs[:-1]), InputError, r"outputs: shape \(255, 2\); expected \(256, 2\)"),
        (replace(member(), validation_inputs=np.empty((0, 2))), InputError, r"with at least one row"),
    ],
)
def test_rows_that_cannot_be_used_are_refused(broken: EnsembleMember, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        train([broken], (4,), QUICK, 0)


def test_divergence_is_an_error_that_says_what_to_change() -> None:
    with pytest.raises(SettingsError, match=r"network m: the loss became (nan|inf) by epoch \d+; .*Lower learning_rate"):
        train([member()], (16, 16, 16), replace(QUICK, learning_rate=1e18), 0)


@pytest.mark.parametrize("key", ["learning_rate", "batch", "epochs", "patience", "check_every"])
def test_settings_that_cannot_be_used_are_refused(key: str) -> None:
    with pytest.raises(SettingsError, match=rf"training: {key} = 0; expected a positive number"):
        train([member()], (4,), replace(QUICK, **{key: 0}), 0)


def test_other_settings_that_cannot_be_used() -> None:
    with pytest.raises(SettingsError, match=r"training: threads = -1; expected a number from 0 on"):
        train([member()], (4,), replace(QUICK, threads=-1), 0)
    with pytest.raises(SettingsError, match=r"network m: learning_rate = 0.0; expected a positive number"):
        train([replace(member(), learning_rate=0.0)], (4,), QUICK, 0)


def test_one_diverging_member_ends_all_of_it() -> None:
    began = threading.active_count()
    with pytest.raises(SettingsError, match=r"network wild: the loss became (nan|inf) by epoch \d+; .*\(now 1e\+18\)"):
        train([member(), replace(member("wild"), learning_rate=1e18)], (16, 16, 16), replace(QUICK, epochs=100_000), 0)
    assert threading.active_count() == began


def test_layers_without_units_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"hidden = \[\]; expected at least one layer"):
        train([member()], (), QUICK, 0)


def test_normalisation_is_undone() -> None:
    values = np.random.default_rng(0).normal(3.0, 1e-5, (50, 2))
    scaler = Normalisation.of(values, ("a", "b"), "here")
    np.testing.assert_allclose(scaler.apply(values).std(axis=0), 1.0)
    np.testing.assert_allclose(scaler.invert(scaler.apply(values)), values, rtol=1e-14)
    mlp = Mlp((np.eye(2),), (np.zeros(2),), scaler, scaler)
    np.testing.assert_allclose(mlp.predict(values), values, rtol=1e-14)
