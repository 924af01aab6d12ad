"""The engine: right gradients, members that do not disturb each other, the same seed the same network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from sysid.errors import ExcitationError, InputError, SettingsError
from sysid.networks import Member, Mlp, Normalisation, Trained, TrainingSettings, train
from sysid.networks.batch import BatchedMlp, FusedAdam

QUICK = TrainingSettings(learning_rate=1e-2, batch=32, epochs=60, patience=60)


def member(name: str = "m", seed: int = 0, noise: float = 0.0, rows: int = 256) -> Member:
    """``y = (sin 2x₀ + x₁, x₀ x₁)`` in units of a few thousand and an offset, which normalisation has to take care of."""
    rng = np.random.default_rng(seed)
    x, v = rng.uniform(-1, 1, (rows, 2)), rng.uniform(-1, 1, (128, 2))

    def y(inputs: np.ndarray) -> np.ndarray:
        values = np.column_stack([np.sin(2 * inputs[:, 0]) + inputs[:, 1], inputs[:, 0] * inputs[:, 1]])
        return 5e3 + 1e3 * (values + rng.normal(0, noise, values.shape) if noise else values)

    return Member(name, x, y(x), v, y(v), ("a", "b"), ("c", "d"))


def same(first: Trained, second: Trained, rtol: float = 0.0) -> bool:
    pairs = zip((*first.mlp.weights, *first.mlp.biases), (*second.mlp.weights, *second.mlp.biases), strict=True)
    return all(np.allclose(a, b, rtol=rtol, atol=rtol) for a, b in pairs)


def test_the_written_out_gradient_is_that_of_autograd() -> None:
    generators = [torch.Generator().manual_seed(k) for k in (1, 2)]
    model = BatchedMlp.initial((3, 8, 5, 2), generators)
    x, y = torch.randn(2, 17, 3), torch.randn(2, 17, 2)
    with torch.no_grad():
        losses = model.accumulate(x, y)
    weights = [w.clone().requires_grad_() for w in model.weights]
    biases = [b.clone().requires_grad_() for b in model.biases]
    h = x
    for w, b in zip(weights[:-1], biases[:-1], strict=True):
        h = torch.relu(h @ w + b)
    expected = ((h @ weights[-1] + biases[-1] - y) ** 2).mean(dim=(1, 2))
    expected.sum().backward()
    torch.testing.assert_close(losses, expected.detach())
    for w, gradient in zip(weights, model.weight_gradients, strict=True):
        torch.testing.assert_close(gradient, w.grad)
    for b, gradient in zip(biases, model.bias_gradients, strict=True):
        torch.testing.assert_close(gradient, b.grad)


def test_dropping_a_member_does_not_change_the_path_of_the_others() -> None:
    x, y = torch.randn(3, 16, 2), torch.randn(3, 16, 1)

    def start() -> BatchedMlp:
        return BatchedMlp.initial((2, 6, 1), [torch.Generator().manual_seed(k) for k in range(3)])

    def steps(model: BatchedMlp, adam: FusedAdam, rows: list[int]) -> None:
        with torch.no_grad():
            for _ in range(10):
                model.accumulate(x[rows], y[rows])
                adam.step(1e-2)

    whole = start()
    adam = FusedAdam(whole, 1e-2)
    steps(whole, adam, [0, 1, 2])
    steps(whole, adam, [0, 1, 2])
    dropped = start()
    adam = FusedAdam(dropped, 1e-2)
    steps(dropped, adam, [0, 1, 2])
    dropped, adam = adam.kept(dropped, [0, 2])
    steps(dropped, adam, [0, 2])
    torch.testing.assert_close(dropped.parameters, whole.parameters[[0, 2]])


def test_training_recovers_a_known_map() -> None:
    (result,) = train([member()], (32, 32), replace(QUICK, epochs=150), seed=0)
    fresh = member(seed=9)
    error = result.mlp.predict(fresh.inputs) - fresh.outputs
    assert np.sqrt((error**2).mean(axis=0)).max() < 30.0  # of a standard deviation of about 1000
    assert result.mlp.hidden == (32, 32)
    assert result.mlp.parameters == 2 * 32 + 32 + 32 * 32 + 32 + 32 * 2 + 2
    assert result.course.rows == (256, 128)
    assert result.course.fit_loss[-1] < 0.1 * result.course.fit_loss[0]


def test_numpy_inference_is_that_of_the_weights() -> None:
    (result,) = train([member()], (8,), replace(QUICK, epochs=5), seed=0)
    mlp, x = result.mlp, member(seed=3).inputs
    by_torch = torch.from_numpy((x - mlp.inputs.mean) / mlp.inputs.scale)
    by_torch = torch.relu(by_torch @ torch.from_numpy(mlp.weights[0]) + torch.from_numpy(mlp.biases[0]))
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


def test_a_member_is_trained_as_if_it_were_alone() -> None:
    quick = replace(QUICK, epochs=20)
    together = train([member("a", 1), member("b", 2)], (16,), quick, seed=0)
    alone = [train([member(name, seed)], (16,), quick, seed=0)[0] for name, seed in (("a", 1), ("b", 2))]
    assert all(same(x, y, rtol=1e-3) for x, y in zip(together, alone, strict=True))
    assert not same(together[0], together[1], rtol=1e-3)


def test_members_of_different_sizes_keep_their_order() -> None:
    members = [member("small", rows=64), member("large"), member("small too", rows=64)]
    results = train(members, (4,), replace(QUICK, epochs=5), seed=0)
    assert [result.course.rows[0] for result in results] == [64, 256, 64]


def test_each_member_stops_by_itself_with_its_best_weights() -> None:
    learnable = member("learnable")
    # Validation rows of the other follow another law: learning more about the fit rows soon makes it worse.
    misleading = replace(member("misleading", seed=1), validation_outputs=member(seed=1).validation_outputs[::-1].copy())
    settings = TrainingSettings(learning_rate=1e-2, batch=32, epochs=120, patience=20)
    first, second = train([learnable, misleading], (32, 32), settings, seed=0)
    assert second.course.epochs < first.course.epochs
    assert second.course.epochs == second.course.best_epoch + 20
    assert second.course.checked_epochs[-1] == second.course.epochs
    best = second.course.validation_loss.index(min(second.course.validation_loss))
    assert second.course.checked_epochs[best] == second.course.best_epoch
    residual = second.mlp.predict(misleading.validation_inputs) - misleading.validation_outputs
    normalised = ((residual / second.mlp.outputs.scale) ** 2).mean()
    assert normalised == pytest.approx(second.course.validation_loss[best], rel=1e-3)


def test_cosine_lowers_the_rate_to_a_hundredth(monkeypatch: pytest.MonkeyPatch) -> None:
    rates: list[float] = []
    step = FusedAdam.step
    monkeypatch.setattr(FusedAdam, "step", lambda self, rate: (rates.append(rate), step(self, rate))[1])
    train([member(rows=32)], (4,), replace(QUICK, epochs=5, schedule="cosine"), seed=0)
    assert rates[0] == pytest.approx(1e-2)
    assert rates[-1] == pytest.approx(1e-4)
    assert rates == sorted(rates, reverse=True)


def test_progress_is_the_share_of_epochs_over_all_batches() -> None:
    seen: list[tuple[float, str]] = []
    members = [member("boom to_joint"), member("stick to_joint", rows=32)]
    train(members, (4,), replace(QUICK, epochs=10), 0, lambda done, text: seen.append((done, text)))
    assert seen == [
        (0.25, "boom to_joint"), (0.5, "boom to_joint"), (0.5, "boom to_joint"),
        (0.75, "stick to_joint"), (1.0, "stick to_joint"), (1.0, "stick to_joint"),
    ]  # fmt: skip


def test_threads_are_put_back() -> None:
    before = torch.get_num_threads()
    train([member()], (4,), replace(QUICK, epochs=1, threads=before + 1), 0)
    assert torch.get_num_threads() == before


def with_value(key: str, value: float) -> Member:
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
def test_rows_that_cannot_be_used_are_refused(broken: Member, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        train([broken], (4,), QUICK, 0)


def test_divergence_is_an_error_that_says_what_to_change() -> None:
    with pytest.raises(SettingsError, match=r"network m: the loss became (nan|inf) by epoch \d+; .*Lower learning_rate"):
        train([member()], (16, 16, 16), replace(QUICK, learning_rate=1e18), 0)


@pytest.mark.parametrize("key", ["learning_rate", "batch", "epochs", "patience", "check_every", "threads"])
def test_settings_that_cannot_be_used_are_refused(key: str) -> None:
    with pytest.raises(SettingsError, match=rf"training: {key} = 0; expected a positive number"):
        train([member()], (4,), replace(QUICK, **{key: 0}), 0)


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
