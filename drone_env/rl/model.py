"""PathQNet: from a map and the telemetry to the value of each action.

    grid uint8[B, H, W] -> Embedding 8 -> Conv 8-16 -> Conv 16-32 -> AdaptiveAvgPool 4x4 -> Linear 64
    concatenated with telemetry float32[B, telemetry_size]
    -> Linear 128, LayerNorm -> Linear 128 -> Linear 64 -> Linear 5

Every layer but the last is followed by ReLU. The network takes maps of any size: what it learned on one it can be
asked about another. A square map may also be flat, uint8[B, H * W], row by row: its sides follow from its length.
"""

from functools import lru_cache
from math import isqrt

import torch
from torch import Tensor, nn

from drone_env.agents.network import EPSILON, POOLED, SHAPES
from drone_env.errors import InvalidValueError


def _linear(name: str, more: int = 0) -> nn.Linear:
    """A linear layer as large as `agents.network` says, with this many inputs more."""
    outputs, inputs = SHAPES[f"{name}.weight"]
    return nn.Linear(inputs + more, outputs)


def _convolution(name: str) -> nn.Conv2d:
    """The same for a convolution of 3 x 3 cells, which leaves the map as large as it is."""
    outputs, inputs, *_ = SHAPES[f"{name}.weight"]
    return nn.Conv2d(inputs, outputs, kernel_size=3, padding=1)


class MapEncoder(nn.Module):
    """The map as 64 features: float32[B, 64] from uint8[B, H, W], or from uint8[B, H * W] of square maps."""

    def __init__(self) -> None:
        super().__init__()
        kinds, width = SHAPES["encoder.embedding.weight"]
        self.embedding = nn.Embedding(kinds, width)
        self.conv1 = _convolution("encoder.conv1")
        self.conv2 = _convolution("encoder.conv2")
        self.linear = _linear("encoder.linear")

    def forward(self, grid: Tensor) -> Tensor:
        """The features of a batch of maps.

        Raises:
            InvalidValueError: if maps are flat, and not square.
        """
        if grid.ndim == 2:
            side = isqrt(grid.shape[1])
            if side * side != grid.shape[1]:
                raise InvalidValueError(f"a flat map is square, got {grid.shape[1]} cells; give the shape (B, H, W)")
            grid = grid.reshape(-1, side, side)
        # Channels last, as the embedding leaves them, is what the convolutions are fastest on.
        x = self.embedding(grid.int()).permute(0, 3, 1, 2)
        x = torch.relu_(self.conv1(x))
        x = torch.relu_(self.conv2(x))
        x = pooling(grid.shape[1], grid.shape[2], x.device) @ x.permute(0, 2, 3, 1).flatten(1, 2)
        return torch.relu(self.linear(x.flatten(1)))


@lru_cache(maxsize=16)
def pooling(height: int, width: int, device: torch.device) -> Tensor:
    """Adaptive average pooling to 4x4 as a matrix, float32[16, height * width].

    The same as `nn.AdaptiveAvgPool2d(4)`, whose backward pass would first copy its input into another layout.
    """
    cells = torch.eye(height * width, device=device).reshape(-1, 1, height, width)
    return nn.functional.adaptive_avg_pool2d(cells, POOLED).flatten(1).T.contiguous()


class PathQNet(nn.Module):
    """The values of the five actions: float32[B, 5] from maps as of `MapEncoder` and float32[B, telemetry_size]."""

    def __init__(self, telemetry_size: int = 5) -> None:
        super().__init__()
        self.encoder = MapEncoder()
        self.head = nn.Sequential(
            _linear("head.0", telemetry_size),
            nn.LayerNorm(list(SHAPES["head.1.weight"]), eps=EPSILON),
            nn.ReLU(),
            _linear("head.3"),
            nn.ReLU(),
            _linear("head.5"),
            nn.ReLU(),
            _linear("head.7"),
        )

    def forward(self, grid: Tensor, telemetry: Tensor) -> Tensor:
        """The value of each action.

        Raises:
            InvalidValueError: as `MapEncoder.forward`.
        """
        return self.head(torch.cat([self.encoder(grid), telemetry], dim=1))
