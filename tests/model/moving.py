"""Windows of objects that move as told, for tests of training."""

from __future__ import annotations

import torch

from hbbatch.model.windows import WindowSet, window_set


def simulated(
    objects: int = 40,
    frames: int = 40,
    acceleration_m_s2: float = 0.0,
    noise_m: float = 0.1,
    seed: int = 0,
) -> WindowSet:
    """Vehicles driving straight ahead along their heading, measured with white noise."""
    generator = torch.Generator().manual_seed(seed)
    dt = 0.1
    yaw = torch.rand(objects, 1, generator=generator, dtype=torch.float64) * 6.28
    speed = 5 + 5 * torch.rand(objects, 1, generator=generator, dtype=torch.float64)
    push = torch.randn(objects, frames, generator=generator, dtype=torch.float64)
    velocity = speed + torch.cumsum(push * acceleration_m_s2 * dt**0.5, dim=1)
    distance = torch.cumsum(velocity * dt, dim=1)
    truth = torch.zeros(objects, frames, 7, dtype=torch.float64)
    truth[..., 0], truth[..., 1] = distance * yaw.cos(), distance * yaw.sin()
    truth[..., 3:6] = torch.tensor([4.5, 1.8, 1.5])
    truth[..., 6] = yaw
    noise = torch.randn(truth.shape, generator=generator, dtype=torch.float64)
    scale = torch.tensor([noise_m, noise_m, 0.05, 0.1, 0.05, 0.05, 0.02])
    count = objects * frames
    columns = {
        "truth": truth.reshape(count, 7),
        "measured": (truth + noise * scale).reshape(count, 7),
        "seen": torch.rand(count, generator=generator) < 0.9,
        "sight_m": truth[..., :3].reshape(count, 3) + torch.tensor([20.0, 0.0, 0.0]),
        "score": torch.ones(count),
        "dt_s": torch.full((count,), dt),
    }
    first = torch.arange(objects) * frames
    kind = torch.zeros(objects, dtype=torch.long)
    return window_set(columns, first, torch.full((objects,), frames), kind, 8)
