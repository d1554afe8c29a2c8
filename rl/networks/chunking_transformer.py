"""The network of ACT (Zhao et al., "Learning fine-grained bimanual manipulation", RSS 2023), small, without images.

An encoder sees tokens: a style and parts of the observation's features. A decoder has a query for each action of a
chunk, and attends to them. In training, the style is drawn from what another encoder makes of the demonstrated chunk;
in use it is zero, the middle of its prior.
"""

from typing import Any

import torch
from torch.nn.functional import scaled_dot_product_attention

from armctl.rl.networks.chunks import ChunkNetwork

HEADS = 4
STYLE = 8
"""Numbers of a style."""
FEATURE_TOKENS = 4
"""Tokens that the features become."""


class Attention(torch.nn.Module):
    """Attention of tokens (n, a, d) to others (n, b, d) by `HEADS` heads (Vaswani et al., NeurIPS 2017)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.query, self.key, self.value, self.out = (torch.nn.Linear(width, width) for _ in range(4))

    def forward(self, tokens: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
        """Return what tokens (n, a, d) take from others (n, b, d)."""
        parts = (self.query(tokens), self.key(others), self.value(others))
        heads = (part.unflatten(2, (HEADS, -1)).transpose(1, 2) for part in parts)
        return self.out(scaled_dot_product_attention(*heads).transpose(1, 2).flatten(2))


class Block(torch.nn.Module):
    """Attention of tokens to others, or to each other if there are none, and a layer for each token."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.attention = Attention(width)
        self.layer = torch.nn.Sequential(
            torch.nn.Linear(width, 2 * width), torch.nn.ReLU(), torch.nn.Linear(2 * width, width)
        )
        self.norms = torch.nn.ModuleList(torch.nn.LayerNorm(width) for _ in range(2))

    def forward(self, tokens: torch.Tensor, others: torch.Tensor | None = None) -> torch.Tensor:
        """Return the next tokens (n, a, d)."""
        normal = self.norms[0](tokens)
        tokens = tokens + self.attention(normal, normal if others is None else others)
        return tokens + self.layer(self.norms[1](tokens))


class ChunkingTransformer(ChunkNetwork):
    """Plans a chunk at once; `style_weight` weighs the divergence of styles from their prior in the loss."""

    def __init__(self, *args: Any, width: int, blocks: int, style_weight: float, **options: Any) -> None:
        super().__init__(*args, **options)
        self._style_weight = style_weight
        self.tokens = torch.nn.Linear(self.features.features_dim, FEATURE_TOKENS * width)
        self.of_style = torch.nn.Linear(STYLE, width)
        self.of_chunk = torch.nn.Sequential(
            torch.nn.Linear(self.features.features_dim + len(self.mean), width),
            torch.nn.ReLU(),
            torch.nn.Linear(width, 2 * STYLE),
        )
        self.places = torch.nn.Parameter(0.02 * torch.randn(1 + FEATURE_TOKENS, width))
        self.queries = torch.nn.Parameter(0.02 * torch.randn(self.length, width))
        self.encoder = torch.nn.ModuleList(Block(width) for _ in range(blocks))
        self.decoder = torch.nn.ModuleList(Block(width) for _ in range(blocks))
        self.last = torch.nn.Sequential(torch.nn.LayerNorm(width), torch.nn.Linear(width, self.count))

    def error(self, observations: Any, chunks: torch.Tensor) -> torch.Tensor:
        """Return the mean absolute error of chunks (n, length * k), and the divergence of their styles."""
        features = self.features(observations)
        middle, log_variance = self.of_chunk(torch.cat((features, chunks), dim=1)).chunk(2, dim=1)
        style = middle + (log_variance / 2).exp() * torch.randn_like(middle)
        divergence = (middle.square() + log_variance.exp() - 1 - log_variance).sum(dim=1).mean() / 2
        return (self._decoded(features, style) - chunks).abs().mean() + self._style_weight * divergence

    def planned(self, observations: Any) -> torch.Tensor:
        """Return chunks (n, length * k), in units of their standard deviation."""
        features = self.features(observations)
        return self._decoded(features, torch.zeros_like(features[:, :1]).expand(-1, STYLE))

    def _decoded(self, features: torch.Tensor, style: torch.Tensor) -> torch.Tensor:
        parts = self.tokens(features).unflatten(1, (FEATURE_TOKENS, -1))
        tokens = torch.cat((self.of_style(style)[:, None], parts), dim=1) + self.places
        for block in self.encoder:
            tokens = block(tokens)
        actions = self.queries + torch.zeros_like(tokens[:, :1])
        for block in self.decoder:
            actions = block(actions, tokens)
        return self.last(actions).flatten(1)
