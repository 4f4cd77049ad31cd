"""Convolutions of small images with few filters, as fast on a GPU as their arithmetic allows."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

#: Largest matrix that a convolution is laid out as; beyond it cuDNN's own kernels are used.
_LARGEST = 2**24


class Convolution(nn.Module):
    """Images (B, C, H, W) to (B, F, H, W): stride 1, zeros around, `kernel` pixels wide (odd).

    With `coordinates` each pixel's row and column, from -1 to 1, are two more channels (CoordConv,
    Liu et al. 2018). They are the same in every image, so they are convolved once.

    GPU libraries are made for many filters: a figure's two take fifty times longer than their
    arithmetic. There an image is one row, and the convolution one matrix (:func:`as_matrix`).
    """

    grid: Tensor

    def __init__(
        self, shape: tuple[int, int, int], filters: int, kernel: int, *, coordinates: bool = False
    ) -> None:
        super().__init__()
        channels, height, width = shape
        seen = channels + 2 * coordinates
        plain = nn.Conv2d(seen, filters, kernel)
        self.weight, self.bias = plain.weight, plain.bias
        self.channels, self.coordinates = channels, coordinates
        rows, columns = torch.linspace(-1, 1, height), torch.linspace(-1, 1, width)
        grid = torch.stack(torch.meshgrid(rows, columns, indexing="ij"))
        self.register_buffer("grid", grid, persistent=False)

    def forward(self, image: Tensor) -> Tensor:
        assert self.bias is not None
        weight, padding = self.weight[:, : self.channels], self.weight.shape[-1] // 2
        constant = self.bias[:, None, None]
        if self.coordinates:
            of_grid = self.weight[:, self.channels :]
            constant = constant + nn.functional.conv2d(self.grid, of_grid, padding=padding)
        size = image.shape[-3:].numel() * weight.shape[0] * image.shape[-2:].numel()
        if image.device.type != "cuda" or size > _LARGEST:
            return nn.functional.conv2d(image, weight, padding=padding) + constant
        out = image.flatten(1) @ as_matrix(weight, image.shape[-2], image.shape[-1])
        return out.unflatten(1, (weight.shape[0], *image.shape[-2:])) + constant


def as_matrix(weight: Tensor, height: int, width: int) -> Tensor:
    """The convolution by `weight` (F, C, K, K) of images (C, H, W), zeros around, as one matrix
    (C·H·W, F·H·W) that multiplies images laid out as rows.

    In the image with its border, laid out as a row, the weights of an output pixel are those of the
    pixel before it, shifted by one: all are rows of a matrix that repeats one long row.
    """
    filters, channels, k, _ = weight.shape
    border = k // 2
    wide, high = width + 2 * border, height + 2 * border
    first = nn.functional.pad(weight, (0, wide - k, 0, high - k)).flatten(2)  # of pixel 0
    row = nn.functional.pad(first, (0, 1))  # one longer, so that each repetition shifts
    shifts = height * wide
    repeated = row.unsqueeze(2).expand(-1, -1, shifts, -1).flatten(2)
    matrix = repeated[..., : shifts * high * wide].view(filters, channels, height, wide, high, wide)
    inner = matrix[:, :, :, :width, border : border + height, border : border + width]
    return inner.permute(1, 4, 5, 0, 2, 3).reshape(
        channels * height * width, filters * height * width
    )


def convolutions(
    shape: tuple[int, int, int],
    filters: tuple[int, ...],
    kernels: tuple[int, ...],
    *,
    pool: int,
    coordinates: bool,
    activation: Callable[[], nn.Module],
) -> tuple[list[nn.Module], int]:
    """The layers from images (B, C, H, W) to flat features, and how many features these are: each
    convolution is followed by max-pooling over `pool` pixels and by `activation` (monotonic, so
    that the order of the two does not matter)."""
    layers: list[nn.Module] = []
    channels, height, width = shape
    for count, kernel in zip(filters, kernels, strict=True):
        first = coordinates and not layers
        convolution = Convolution((channels, height, width), count, kernel, coordinates=first)
        layers += [convolution, nn.MaxPool2d(pool), activation()]
        channels, height, width = count, height // pool, width // pool
    return [*layers, nn.Flatten()], channels * height * width
