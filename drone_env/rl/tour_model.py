"""The tour network in PyTorch."""

import math

import torch
from torch import Tensor, nn

from drone_env.agents.tour_view import EDGE_FEATURES, OPTION_FEATURES, TOKEN_FEATURES


class Block(nn.Module):
    """Attention whose weights and messages know the edges, then a layer for each token."""

    def __init__(self, width: int, heads: int, edge: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.bias = nn.Linear(edge, heads)
        self.out = nn.Linear(width + heads * edge, width)
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.up, self.down = nn.Linear(width, 2 * width), nn.Linear(2 * width, width)

    def forward(self, x: Tensor, e: Tensor, absent: Tensor) -> Tensor:
        """The next x, float32[B, N, width], from edges float32[B, N, N, edge]; absent, float32[B, N], is -1e9 or 0."""
        b, n, w = x.shape
        h = self.heads
        q, k, v = self.qkv(self.norm1(x)).view(b, n, 3, h, w // h).permute(2, 0, 3, 1, 4)
        a = q @ k.transpose(-1, -2) / math.sqrt(w // h) + self.bias(e).permute(0, 3, 1, 2)
        a = (a + absent[:, None, None, :]).softmax(-1)
        seen = torch.matmul(a.permute(0, 2, 1, 3), e)  # b, n, h, edge
        x = x + self.out(torch.cat([(a @ v).permute(0, 2, 1, 3).reshape(b, n, w), seen.reshape(b, n, -1)], -1))
        return x + self.down(torch.relu(self.up(self.norm2(x))))


class TourNet(nn.Module):
    """From views to the logit of each option, and the logit of whether the mission can be completed after it."""

    def __init__(self, width: int = 64, heads: int = 4, layers: int = 4, edge: int = 16, hidden: int = 64) -> None:
        super().__init__()
        self.tokens = nn.Linear(TOKEN_FEATURES, width)
        self.edges1, self.edges2 = nn.Linear(EDGE_FEATURES, 32), nn.Linear(32, edge)
        self.blocks = nn.ModuleList([Block(width, heads, edge) for _ in range(layers)])
        self.norm = nn.LayerNorm(width)
        self.node = nn.Linear(width, hidden)
        self.option = nn.Linear(OPTION_FEATURES, hidden, bias=False)
        self.hidden = nn.Linear(hidden, hidden)
        self.head = nn.Linear(hidden, 2)

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
