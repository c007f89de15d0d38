"""Training: windows, augmentation, losses, and that something is learned."""

from __future__ import annotations

import math

import pytest
import torch

from hbbatch.model.horizon import EVERY_FRAME, SLOWER, filter_errors
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.kinds import KINDS
from hbbatch.model.likelihood import fit_noise
from hbbatch.model.losses import box_error, direction_loss, temporal_loss
from hbbatch.model.train_settings import TrainSettings
from hbbatch.model.training import augment, batch_losses, strides, total_loss, train_hybrid
from tests.model.moving import simulated

QUICK = TrainSettings(
    iterations=40, batch=32, frames=12, learning_rate=5e-3, thinned_probability=0.0
)


def quiet(_iteration: int, _loss: float) -> None:
    pass


def test_windows_start_at_detections_and_end_with_their_object() -> None:
    data = simulated(objects=3, frames=12)
    assert data.columns["seen"][data.start].all()
    windows = data.cut(torch.arange(len(data)), 12)
    assert windows.seen[:, 0].all()
    assert torch.equal(windows.valid.sum(1), data.frames_left)
    assert not (windows.seen & ~windows.valid).any()
    assert (windows.dt_s[:, 1:] > 0).all()


def test_rare_kinds_are_drawn_more_often_than_their_share() -> None:
    data = simulated()
    kinds = torch.zeros(len(data), dtype=torch.long)
    kinds[: len(data) // 100] = 1
    mixed = type(data)(data.columns, data.start, data.frames_left, kinds)
    drawn = mixed.draw(20_000, torch.Generator().manual_seed(0))
    share = (kinds[drawn] == 1).double().mean().item()
    assert share == pytest.approx(0.1 / (0.1 + math.sqrt(0.99)), abs=0.02)


def test_mirror_images_are_consistent_and_bursts_hide_detections() -> None:
    data = simulated()
    windows = data.cut(torch.arange(64), 12)
    some = augment(windows, TrainSettings(burst_probability=1.0), torch.Generator().manual_seed(1))
    side = torch.sign(some.truth[:, 5, 1] * windows.truth[:, 5, 1])
    assert set(side.tolist()) == {1.0, -1.0}
    assert some.measured[..., 1] == pytest.approx(windows.measured[..., 1] * side[:, None])
    assert some.truth[..., 6] == pytest.approx(windows.truth[..., 6] * side[:, None])
    assert some.sight_m[..., 1] == pytest.approx(windows.sight_m[..., 1] * side[:, None])
    assert some.seen.sum() < windows.seen.sum()
    assert some.seen[:, 0].all()


def test_box_error_is_taken_along_the_heading_of_the_truth() -> None:
    truth = torch.tensor([[1.0, 2.0, 0.0, 4.0, 2.0, 1.5, math.pi / 2]], dtype=torch.float64)
    off = truth + torch.tensor([[0.3, 0.5, -0.1, 0.2, 0.0, 0.1, math.pi + 0.1]])
    expected = [0.5, 0.3, 0.1, 0.1, 0.2, 0.0, 0.1]
    assert box_error(off, truth)[0].tolist() == pytest.approx(expected, abs=1e-5)


def test_the_papers_further_losses() -> None:
    forward, left = torch.tensor([[2.0, 0.0, 0.0]]), torch.tensor([[0.0, 1.0, 0.0]])
    assert temporal_loss(forward).item() == 2.0
    assert direction_loss(forward, forward).item() == 0.0
    assert direction_loss(forward, left).item() == pytest.approx(math.sqrt(2.0), abs=1e-4)


def test_each_loss_weighs_as_set() -> None:
    parts = batch_losses(KalmanFilter(KINDS), simulated().cut(torch.arange(8), 10))
    only_time = TrainSettings(state_weight=0.0, temporal_weight=2.0)
    assert total_loss(parts, only_time).item() == pytest.approx(2 * parts.temporal.item())
    assert parts.direction.item() > 0


def trained(seed: int = 0) -> tuple[HybridFilter, list[float]]:
    torch.manual_seed(seed)
    motion = HybridFilter(KINDS)
    history = train_hybrid(motion, simulated(), QUICK.model_copy(update={"seed": seed}), quiet)
    return motion, history


def test_training_makes_the_loss_smaller_and_leaves_the_base_alone() -> None:
    before = HybridFilter(KINDS).base.state_dict()
    motion, history = trained()
    assert sum(history[-10:]) < 0.9 * sum(history[:10])
    for name, value in motion.base.state_dict().items():
        assert torch.equal(value, before[name]), name


@pytest.mark.parametrize(("part", "silent"), [("prediction", "gain"), ("update", "residual")])
def test_a_part_that_is_not_learned_says_nothing(part: str, silent: str) -> None:
    torch.manual_seed(0)
    motion = HybridFilter(KINDS)
    settings = QUICK.model_copy(update={"learn": part, "iterations": 3})
    train_hybrid(motion, simulated(), settings, quiet)
    read_outs = {
        "gain": [motion.gain.read_out.weight],
        "residual": [layer.weight for layer in motion.residual.heads_out.values()],
    }
    spoken = "residual" if silent == "gain" else "gain"
    assert all((weight == 0).all() for weight in read_outs[silent])
    assert any((weight != 0).any() for weight in read_outs[spoken])


def test_the_same_seed_gives_the_same_weights() -> None:
    first, second = trained()[0].state_dict(), trained()[0].state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_noise_is_recovered_by_likelihood() -> None:
    """The fit finds the noise that the measurements were made with, from innovations alone."""
    torch.manual_seed(0)
    motion = KalmanFilter(KINDS, "cv")
    data = simulated(objects=150, acceleration_m_s2=1.0, noise_m=0.2)
    history = fit_noise(motion, data, iterations=150, batch=128, frames=15, seed=0, progress=quiet)
    assert history[-1] < history[0]
    far = data.cut(torch.arange(len(data)), 2).measurement(0)
    variance, _ = motion.measurement_variance(far, data.kind_code)
    assert variance[:, 0].mean().sqrt().item() == pytest.approx(0.2, rel=0.2)
    assert motion.log_q[0, 0].exp().sqrt().item() == pytest.approx(1.0, rel=0.4)


def test_errors_are_reported_for_every_age_and_horizon() -> None:
    windows = simulated().cut(torch.arange(200), EVERY_FRAME.frames)
    errors = filter_errors(KalmanFilter(KINDS), windows)
    assert {(e.age, e.frames_ahead) for e in errors} == {
        (a, h) for a in EVERY_FRAME.ages for h in (0, *EVERY_FRAME.horizons)
    }
    by_key = {(e.age, e.frames_ahead): e.plan_m for e in errors}
    assert by_key[18, 0] < by_key[18, 1] < by_key[18, 5] < by_key[18, 10]
    assert by_key[18, 5] < by_key[3, 5]


def test_the_likelihood_teaches_how_far_off_boxes_are() -> None:
    """Untrained, the filter thinks measurements far better than they are."""
    data = simulated(noise_m=0.4)
    windows = data.cut(torch.arange(100), 12)

    def surprise(weight: float) -> float:
        torch.manual_seed(0)
        motion = HybridFilter(KINDS)
        with torch.no_grad():
            motion.base.log_r.fill_(-7.0)
            motion.base.log_q.fill_(-7.0)
        settings = QUICK.model_copy(update={"learn": "both", "likelihood_weight": weight})
        train_hybrid(motion, data, settings, quiet)
        return batch_losses(motion, windows).likelihood.item()

    assert surprise(0.1) < surprise(0.0) - 0.5


def test_a_slower_sensor_has_more_to_predict() -> None:
    data = simulated(frames=80, acceleration_m_s2=1.0)
    slow = SLOWER[1]
    chosen = torch.nonzero(data.frames_left >= slow.rows).flatten()
    errors = filter_errors(KalmanFilter(KINDS), data.cut(chosen, slow.frames, slow.stride), slow)
    ahead = {e.frames_ahead: e for e in errors}
    assert {e.stride for e in errors} == {5}
    usual = filter_errors(KalmanFilter(KINDS), data.cut(chosen, EVERY_FRAME.frames))
    next_frame = next(e for e in usual if (e.age, e.frames_ahead) == (10, 1))
    assert ahead[1].plan_m > 2 * next_frame.plan_m


def test_thinned_windows_keep_every_kth_frame_and_its_time() -> None:
    data = simulated(objects=3, frames=40)
    stride = torch.tensor([1, 2, 5])
    some = torch.tensor([0, 0, 0])
    whole, thinned = data.cut(some, 31), data.cut(some, 7, stride)
    for row, step in enumerate(stride.tolist()):
        assert torch.equal(thinned.truth[row], whole.truth[row, : 7 * step : step][:7])
        assert thinned.dt_s[row, 1:].tolist() == pytest.approx([0.1 * step] * 6)
    assert data.cut(some, 20, 5).valid[0].sum() == -(-data.frames_left[0] // 5)


def test_short_objects_are_thinned_less() -> None:
    settings = TrainSettings(thinned_probability=1.0, longest_stride=5, min_frames=8)
    drawn = strides(torch.tensor([10] * 50 + [17] * 50 + [200] * 50), settings, _generator())
    assert drawn[:50].tolist() == [1] * 50
    assert set(drawn[50:100].tolist()) == {1, 2}
    assert set(drawn[100:].tolist()) == {1, 2, 3, 4, 5}
    never = settings.model_copy(update={"thinned_probability": 0.0})
    assert strides(torch.tensor([200] * 50), never, _generator()).tolist() == [1] * 50


def _generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)
