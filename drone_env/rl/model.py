"""The networks in PyTorch: PathQNet, which values actions; the tour network, which chooses where to fly next; PPO's.

PathQNet:

    grid uint8[B, H, W] -> Embedding 8 -> Conv 8-16 -> Conv 16-32 -> AdaptiveAvgPool 4x4 -> Linear 64
    concatenated with telemetry float32[B, telemetry_size]
    -> Linear 128, LayerNorm -> Linear 128 -> Linear 64 -> Linear 5

ReLU follows every layer but the last. The network takes maps of any size.
"""

from functools import lru_cache
from math import isqrt, sqrt

import torch
from torch import Tensor, nn

from drone_env.agents.pathqnet import MAP_FEATURES, POOLED
from drone_env.agents.tour_features import EDGE_FEATURES, OPTION_FEATURES, TOKEN_FEATURES
from drone_env.agents.tour_network import EDGE, EDGE_HIDDEN, HEADS, HIDDEN, LAYERS, WIDTH
from drone_env.agents.weights_file import EPSILON
from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import N_CELL_KINDS
from drone_env.errors import InvalidValueError


class MapEncoder(nn.Module):
    """The map as 64 features: float32[B, 64] from uint8[B, H, W]."""

    def __init__(self) -> None:
        super().__init__()
        self.embedding = nn.Embedding(N_CELL_KINDS, 8)
        self.conv1 = nn.Conv2d(8, 16, kernel_size=3, padding=1)
        self.conv2 = nn.Conv2d(16, 32, kernel_size=3, padding=1)
        self.linear = nn.Linear(32 * POOLED * POOLED, MAP_FEATURES)

    def forward(self, grid: Tensor) -> Tensor:
        """The features of a batch of maps."""
        # The convolutions are fastest on channels last, the layout of the embedding.
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
    """The values of the five actions: float32[B, 5] from uint8[B, H, W] and float32[B, telemetry_size].

    A square map may also be flat, [B, H * W].
    """

    def __init__(self, telemetry_size: int = 5) -> None:
        super().__init__()
        self.encoder = MapEncoder()
        self.head = nn.Sequential(
            nn.Linear(MAP_FEATURES + telemetry_size, 128),
            nn.LayerNorm(128, eps=EPSILON),
            nn.ReLU(),
            nn.Linear(128, 128),
            nn.ReLU(),
            nn.Linear(128, 64),
            nn.ReLU(),
            nn.Linear(64, N_ACTIONS),
        )

    def forward(self, grid: Tensor, telemetry: Tensor) -> Tensor:
        """The value of each action."""
        if grid.dim() == 2:
            side = isqrt(grid.shape[1])
            if side * side != grid.shape[1]:
                raise InvalidValueError(f"a flat map must be square, got {grid.shape[1]} cells: pass uint8[B, H, W]")
            grid = grid.reshape(-1, side, side)
        return self.head(torch.cat([self.encoder(grid), telemetry], dim=1))


class Block(nn.Module):
    """Attention with edge features in its weights and messages, then a layer for each token."""

    def __init__(self) -> None:
        super().__init__()
        self.qkv = nn.Linear(WIDTH, 3 * WIDTH)
        self.bias = nn.Linear(EDGE, HEADS)
        self.out = nn.Linear(WIDTH + HEADS * EDGE, WIDTH)
        self.norm1, self.norm2 = nn.LayerNorm(WIDTH), nn.LayerNorm(WIDTH)
        self.up, self.down = nn.Linear(WIDTH, 2 * WIDTH), nn.Linear(2 * WIDTH, WIDTH)

    def forward(self, x: Tensor, e: Tensor, absent: Tensor) -> Tensor:
        """The next x, float32[B, N, width], from edges float32[B, N, N, edge]; absent, float32[B, N], is -1e9 or 0."""
        b, n, w = x.shape
        q, k, v = self.qkv(self.norm1(x)).view(b, n, 3, HEADS, w // HEADS).permute(2, 0, 3, 1, 4)
        a = q @ k.transpose(-1, -2) / sqrt(w // HEADS) + self.bias(e).permute(0, 3, 1, 2)
        a = (a + absent[:, None, None, :]).softmax(-1)
        messages = torch.matmul(a.permute(0, 2, 1, 3), e)  # b, n, h, edge
        x = x + self.out(torch.cat([(a @ v).permute(0, 2, 1, 3).reshape(b, n, w), messages.reshape(b, n, -1)], -1))
        return x + self.down(torch.relu(self.up(self.norm2(x))))


class TourNet(nn.Module):
    """From features to two logits for each option: its choice, and whether it loses no parcel."""

    def __init__(self) -> None:
        super().__init__()
        self.tokens = nn.Linear(TOKEN_FEATURES, WIDTH)
        self.edges1, self.edges2 = nn.Linear(EDGE_FEATURES, EDGE_HIDDEN), nn.Linear(EDGE_HIDDEN, EDGE)
        self.blocks = nn.ModuleList([Block() for _ in range(LAYERS)])
        self.norm = nn.LayerNorm(WIDTH)
        self.node = nn.Linear(WIDTH, HIDDEN)
        self.option = nn.Linear(OPTION_FEATURES, HIDDEN, bias=False)
        self.hidden = nn.Linear(HIDDEN, HIDDEN)
        self.head = nn.Linear(HIDDEN, 2)

    def forward(self, tokens: Tensor, present: Tensor, edges: Tensor, owner: Tensor, token: Tensor, features: Tensor):
        """Preference and completion logits of each option; owner int64[options]: its state, token: its token."""
        x = self.tokens(tokens)
        e = torch.relu(self.edges2(torch.relu(self.edges1(edges))))
        absent = (~present).float() * -1e9
        for block in self.blocks:
            x = block(x, e, absent)
        x = self.node(self.norm(x))
        y = torch.relu(x[owner, token] + self.option(features))
        y = y + torch.relu(self.hidden(y))
        y = self.head(y)
        return y[:, 0], y[:, 1]


class ActorCritic(nn.Module):
    """The logits of the actions, float32[B, 5], and the values of the states, float32[B].

    Inputs are those of `envs.forms.StopEntries`: entries int32[B, L] and features float32[B, features].
    """

    def __init__(self, entries: int, features: int, hidden: int) -> None:
        super().__init__()
        self.stops = nn.EmbeddingBag(entries, hidden, mode="sum", padding_idx=0)
        nn.init.normal_(self.stops.weight, std=0.05)
        nn.init.zeros_(self.stops.weight.data[0])
        self.features, self.hidden = orthogonal(features, hidden), orthogonal(hidden, hidden)
        self.actor, self.critic = orthogonal(hidden, N_ACTIONS, 0.01), orthogonal(hidden, 1, 1.0)

    def forward(self, entries: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        """Logits and values of B states."""
        x = torch.relu(self.stops(entries) + self.features(features))
        x = torch.relu(self.hidden(x))
        return self.actor(x), self.critic(x)[:, 0]


def orthogonal(inputs: int, outputs: int, gain: float = sqrt(2)) -> nn.Linear:
    """A linear layer with orthogonal weights."""
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer
