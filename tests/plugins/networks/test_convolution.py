"""Convolutions of small images."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from understudy_networks.convolution import Convolution, as_matrix, convolutions


@pytest.mark.parametrize("kernel", [1, 3, 5])
@pytest.mark.parametrize("size", [(6, 9), (5, 5), (2, 7)])
def test_the_matrix_is_the_convolution_and_so_is_its_gradient(
    kernel: int, size: tuple[int, int]
) -> None:
    chance = torch.Generator().manual_seed(0)
    image = torch.randn(4, 3, *size, generator=chance, dtype=torch.float64)
    weight = torch.randn(2, 3, kernel, kernel, generator=chance, dtype=torch.float64)
    weight.requires_grad_()
    out = nn.functional.conv2d(image, weight, padding=kernel // 2)
    rows = image.flatten(1) @ as_matrix(weight, *size)
    torch.testing.assert_close(rows, out.flatten(1))
    towards = torch.randn(out.shape, generator=chance, dtype=torch.float64)
    (expected,) = torch.autograd.grad((out * towards).sum(), weight)
    (found,) = torch.autograd.grad((rows * towards.flatten(1)).sum(), weight)
    torch.testing.assert_close(found, expected)


def test_coordinates_are_two_more_channels() -> None:
    """Row and column from -1 to 1, appended to the image (Liu et al. 2018)."""
    layer = Convolution((1, 3, 5), 2, 3, coordinates=True)
    image = torch.rand(4, 1, 3, 5, generator=torch.Generator().manual_seed(0))
    rows = torch.tensor([-1.0, 0, 1]).view(1, 1, 3, 1).expand(4, 1, 3, 5)
    columns = torch.tensor([-1, -0.5, 0, 0.5, 1]).view(1, 1, 1, 5).expand(4, 1, 3, 5)
    seen = torch.cat([image, rows, columns], dim=1)
    expected = nn.functional.conv2d(seen, layer.weight, layer.bias, padding=1)
    torch.testing.assert_close(layer(image), expected)


def test_layers_say_how_many_features_they_give() -> None:
    layers, size = convolutions(
        (2, 13, 10), (3, 4), (5, 3), pool=2, coordinates=True, activation=nn.ReLU
    )
    assert nn.Sequential(*layers)(torch.zeros(6, 2, 13, 10)).shape == (6, size) == (6, 4 * 3 * 2)


@pytest.mark.gpu
def test_on_a_gpu_it_is_the_same_function() -> None:
    layer = Convolution((2, 32, 32), 2, 5, coordinates=True)
    image = torch.rand(64, 2, 32, 32, generator=torch.Generator().manual_seed(0))
    expected = layer(image)
    found = layer.to("cuda")(image.to("cuda")).cpu()
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)
