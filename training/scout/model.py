"""The scout: a fully convolutional network that is told what to look for late.

The trunk sees the panorama only, so that many queries share it. It halves the picture four times and comes back to a
quarter of its size (a U-Net with residual blocks); rows are padded with zeros, columns around the seam. A channel with
sin(elevation) tells floors from ceilings and leaves all azimuths alike. The query, a category and perhaps a colour,
scales and shifts the features of each cell (FiLM, Perez et al. 2018) before two thin layers answer with a logit per
cell, and one logit for the presence of the thing at all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

STRIDE = 4  # pixels of the input to a cell of the heat map
COARSEST = 16  # the picture can be rolled by so many pixels and the answer rolls with it


@dataclass(frozen=True)
class Size:
    """Rows of the input, and widths of the layers."""

    rows: int = 160
    first: int = 24
    quarter: int = 40
    eighth: int = 88
    sixteenth: int = 128
    features: int = 64
    answer: int = 32
    words: int = 64


class _Around(torch.autograd.Function):
    """The same as `around`; what autograd makes of the slices there takes a fifth of a training step."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, by: int) -> Tensor:
        ctx.by = by
        return torch.cat([x[..., -by:], x, x[..., :by]], dim=-1)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        (gradient,), by = gradients, ctx.by
        inner = gradient[..., by:-by].clone(memory_format=torch.preserve_format)
        inner[..., -by:] += gradient[..., :by]
        inner[..., :by] += gradient[..., -by:]
        return inner, None


def around(x: Tensor, by: int) -> Tensor:
    """`x` ``(..., H, W)`` with `by` columns from beyond the seam on each side."""
    if torch.is_grad_enabled() and x.requires_grad:
        return _Around.apply(x, by)  # type: ignore[no-any-return]
    return torch.cat([x[..., -by:], x, x[..., :by]], dim=-1)


class Conv(nn.Module):
    """3 x 3 convolution around the seam, batch normalisation and, if wanted, a ReLU."""

    def __init__(self, before: int, after: int, stride: int = 1, relu: bool = True, dilation: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(before, after, 3, stride, (dilation, 0), dilation, bias=False)
        self.norm = nn.BatchNorm2d(after)
        self.relu, self.pad = relu, dilation

    def forward(self, x: Tensor) -> Tensor:
        x = self.norm(self.conv(around(x, self.pad)))
        return F.relu(x) if self.relu else x


class Block(nn.Module):
    """Two convolutions and the way past them."""

    def __init__(self, width: int, dilation: int = 1) -> None:
        super().__init__()
        self.first = Conv(width, width, dilation=dilation)
        self.second = Conv(width, width, relu=False)
        nn.init.zeros_(self.second.norm.weight)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(x + self.second(self.first(x)))


class Scout(nn.Module):
    """`categories` and `colours`: how many words of each; `classes`: what the auxiliary head tells apart."""

    def __init__(self, categories: int, colours: int, classes: int, size: Size | None = None) -> None:
        super().__init__()
        self.size = size = size or Size()
        self.stem = Conv(4, size.first, 2)
        self.quarter = nn.Sequential(Conv(size.first, size.quarter, 2), Block(size.quarter))
        self.eighth = nn.Sequential(Conv(size.quarter, size.eighth, 2), Block(size.eighth), Block(size.eighth))
        self.sixteenth = nn.Sequential(
            Conv(size.eighth, size.sixteenth, 2),
            Block(size.sixteenth),
            Block(size.sixteenth, dilation=2),
            Block(size.sixteenth),
        )
        self.up_eighth = nn.Conv2d(size.sixteenth, size.eighth, 1)
        self.join_eighth = Conv(size.eighth, size.features)
        self.up_quarter = nn.Conv2d(size.features, size.quarter, 1)
        self.join_quarter = Conv(size.quarter, size.features)
        self.classes = nn.Conv2d(size.features, classes, 1)  # auxiliary, for training
        self.tints = nn.Conv2d(size.features, colours, 1)
        self.category = nn.Embedding(categories, size.words)
        self.colour = nn.Embedding(colours + 1, size.words)  # the last: no colour said
        self.film = nn.Sequential(
            nn.Linear(size.words, 2 * size.words),
            nn.ReLU(),
            nn.Linear(2 * size.words, size.features + size.answer * 2),
        )
        self.mix = nn.Parameter(torch.randn(size.answer, size.features) * math.sqrt(2 / size.features))
        self.heat_bias = nn.Parameter(torch.tensor(-4.0))
        self.presence = nn.Sequential(nn.Linear(size.answer + 2, 32), nn.ReLU(), nn.Linear(32, 1))
        rows = (torch.arange(size.rows) + 0.5) * (math.pi / size.rows)
        self.register_buffer("latitude", torch.cos(rows).reshape(1, 1, -1, 1), persistent=False)
        cells = (torch.arange(size.rows // STRIDE) + 0.5) * (math.pi * STRIDE / size.rows)
        self.register_buffer("area", torch.sin(cells).reshape(1, 1, -1, 1), persistent=False)

    def trunk(self, image: Tensor) -> Tensor:
        """Features ``(B, F, h, w)`` of images ``(B, 3, H, W)`` in [0, 1]."""
        latitude = self.latitude.to(image.dtype).expand(image.shape[0], 1, -1, image.shape[3])
        quarter = self.quarter(self.stem(torch.cat([image * 2 - 1, latitude], dim=1)))
        eighth = self.eighth(quarter)
        sixteenth = self.sixteenth(eighth)
        eighth = self.join_eighth(F.relu(eighth + _twice(self.up_eighth(sixteenth))))
        return self.join_quarter(F.relu(quarter + _twice(self.up_quarter(eighth))))

    def answer(self, features: Tensor, words: Tensor) -> tuple[Tensor, Tensor]:
        """Heat logits ``(B, Q, h, w)`` and presence logits ``(B, Q)`` for `words` ``(B, Q, 2)``: category, colour."""
        size = self.size
        batch, count = words.shape[0], words.shape[1]
        film = self.film(self.category(words[..., 0]) + self.colour(words[..., 1]))
        scale, shift, weigh = film.split([size.features, size.answer, size.answer], dim=-1)
        # Scaling the features before the mixing layer is scaling the columns of that layer, and a feature that is
        # always 1 carries the shift: one product for all queries.
        mix = torch.cat([self.mix * (1 + scale.unsqueeze(2)), shift.unsqueeze(3)], dim=3)
        flat = features.flatten(2)
        flat = torch.cat([flat, torch.ones_like(flat[:, :1])], dim=1)
        mix = mix.reshape(batch, count * size.answer, size.features + 1).to(flat.dtype)
        hidden = F.relu(torch.bmm(mix, flat)).reshape(batch, count, size.answer, -1)
        heat = torch.matmul(weigh.unsqueeze(2).to(flat.dtype), hidden).squeeze(2).float() + self.heat_bias
        # Where the thing would be if it were anywhere, by solid angle.
        attention = torch.softmax(
            2 * heat + torch.log(self.area).expand(1, 1, -1, features.shape[3]).reshape(1, 1, -1), -1
        )
        pooled = torch.matmul(hidden, attention.unsqueeze(-1).to(flat.dtype)).squeeze(-1).float()
        summary = torch.stack([heat.amax(dim=-1), (heat * attention).sum(dim=-1)], dim=-1)
        presence = self.presence(torch.cat([pooled, summary], dim=-1)).squeeze(-1)
        return heat.reshape(batch, count, features.shape[2], features.shape[3]), presence

    def forward(self, image: Tensor, words: Tensor) -> tuple[Tensor, Tensor]:
        """`answer` of the `trunk`."""
        return self.answer(self.trunk(image), words)


def _twice(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")
