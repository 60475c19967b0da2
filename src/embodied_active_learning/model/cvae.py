"""The conditional variational autoencoder: image at a state -> latents -> image at any state (paper, Table 2)."""

from __future__ import annotations

import math
from typing import Callable, List, NamedTuple, Tuple

import torch
from torch import nn
from torch.nn import functional

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.errors import ConfigError

IMAGE_CHANNELS = 3
LOG_LIMITS = (-10.0, 2.0)

Size = Tuple[int, int]
Linear = Callable[[nn.Linear, torch.Tensor], torch.Tensor]


class LatentGaussian(NamedTuple):
    """Diagonal Gaussian over the latents, q(z | x, y)."""

    mean: torch.Tensor
    log_variance: torch.Tensor

    @property
    def std(self) -> torch.Tensor:
        """(B, L) standard deviation."""
        return torch.exp(0.5 * self.log_variance)


def limited(logarithm: torch.Tensor) -> torch.Tensor:
    """A log std or log variance as the network gives it, within limits that keep its exponential sane."""
    return logarithm.clamp(*LOG_LIMITS)


def is_within_limits(logarithm: torch.Tensor) -> torch.Tensor:
    """Where the slope of limited() is one and not zero."""
    return (logarithm >= LOG_LIMITS[0]) & (logarithm <= LOG_LIMITS[1])


def latent_gaussian(outputs: torch.Tensor) -> LatentGaussian:
    """The encoder's outputs (B, 2 L) as means and log variances."""
    mean, log_variance = outputs.chunk(2, dim=1)
    return LatentGaussian(mean, limited(log_variance))


def convolution_sizes(image_size: Size, config: ModelConfig) -> List[Size]:
    """(height, width) of the image and behind each convolution. Raises ConfigError for an image that is too small."""
    sizes = [(int(image_size[0]), int(image_size[1]))]
    for index, (kernel, stride) in enumerate(zip(config.kernels, config.strides)):
        if min(sizes[-1]) < kernel:
            raise ConfigError(
                f"camera/height x camera/width = {image_size[0]} x {image_size[1]} is too small for the model:"
                f" {sizes[-1][0]} x {sizes[-1][1]} reach convolution {index + 1}, whose kernel is {kernel};"
                " enlarge the image or change model/kernels and model/strides"
            )
        sizes.append(tuple((length - kernel) // stride + 1 for length in sizes[-1]))
    return sizes


def float_images(images: torch.Tensor, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """Stored images (B, H, W, 3) uint8 -> (B, 3, H, W) in [0, 1], channels innermost in memory."""
    return images.permute(0, 3, 1, 2).to(dtype).div_(255.0)


class ConditionalVAE(nn.Module):
    """CVAE with one observation log std per image. 4,309,220 parameters for 180 x 180 images and 3 states.

    image_size: (height, width) in pixels; state_size: number of normalised state dimensions D.
    """

    def __init__(self, image_size: Size, state_size: int, config: ModelConfig) -> None:
        super().__init__()
        sizes = convolution_sizes(image_size, config)
        self.sizes = sizes
        self.image_size = sizes[0]
        self.state_size = state_size
        self.latent_size = config.latent_size
        self.feature_shape = (config.channels[-1], *sizes[-1])
        self.feature_size = math.prod(self.feature_shape)
        hidden = list(config.hidden_sizes)
        self.image_encoder = _image_encoder(config)
        self.encoder = _perceptron([self.feature_size + state_size, *hidden, 2 * config.latent_size])
        self.decoder = _perceptron([config.latent_size + state_size, *hidden[::-1], 1 + self.feature_size])
        self.image_decoder = _image_decoder(config, sizes)

    def encode(self, states: torch.Tensor, images: torch.Tensor) -> LatentGaussian:
        """q(z | x, y). states: (B, D) normalised, images: (B, H, W, 3) uint8 -> mean and log variance, (B, L) each."""
        return self.encode_features(states, self.image_features(images))

    def image_features(self, images: torch.Tensor) -> torch.Tensor:
        """The part of the encoder that sees the image alone. images: (B, H, W, 3) uint8 -> (B, F)."""
        return self.image_encoder(float_images(images, self.encoder[0].weight.dtype)).flatten(1)

    def encode_features(
        self, states: torch.Tensor, features: torch.Tensor, linear: Linear = nn.Linear.__call__
    ) -> LatentGaussian:
        """q(z | x, y) from image features (B, F), or (1, F) shared by all states (B, D) -> (B, L) each.

        linear: how a layer is applied to its inputs.
        """
        first = _first_layer(self.encoder[0], features, states, linear)
        return latent_gaussian(_run(self.encoder[1:], first, linear))

    def decode(self, latents: torch.Tensor, states: torch.Tensor) -> Tuple[torch.Tensor, torch.Tensor]:
        """p(y | z, x). latents: (B, L), states: (B, D) -> mean image (B, 3, H, W) in [0, 1] units, log std (B,)."""
        log_std, features = self.decode_features(latents, states)
        return self.image_decoder(features.unflatten(1, self.feature_shape)), log_std

    def start_at(self, colour: torch.Tensor) -> None:
        """Let the decoder begin around a colour (3,) in [0, 1]: the bias of its last layer.

        From black, the first hundreds of updates go into the images' brightness, and objects may share one colour for
        thousands more.
        """
        with torch.no_grad():
            self.image_decoder[-1].bias.copy_(colour)

    def decode_features(
        self, latents: torch.Tensor, states: torch.Tensor, linear: Linear = nn.Linear.__call__
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        """The decoder before the image. latents: (B, L), states: (B, D) -> log std (B,), features (B, F).

        linear: how a layer is applied to its inputs.
        """
        outputs = _run(self.decoder, torch.cat((latents, states), dim=1), linear)
        return limited(outputs[:, 0]), outputs[:, 1:]

    def log_std(self, latents: torch.Tensor, states: torch.Tensor) -> torch.Tensor:
        """Log standard deviation of p(y | z, s) at states (S, D), for latents (S, L) or one (1, L) or (L,) -> (S,).

        Leaves out the image and the 3920 outputs that lead to it: conditional entropy needs this number alone.
        """
        hidden = _first_layer(self.decoder[0], latents.reshape(-1, self.latent_size), states)
        hidden = self.decoder[1:-1](hidden)
        head = self.decoder[-1]
        return limited(functional.linear(hidden, head.weight[:1], head.bias[:1])[:, 0])


def initialise(network: nn.Module, generator: torch.Generator) -> None:
    """PyTorch's default initialisation, U(-1/sqrt(fan_in), 1/sqrt(fan_in)), from a generator of our own."""
    with torch.no_grad():
        for layer in network.modules():
            if isinstance(layer, (nn.Linear, nn.Conv2d, nn.ConvTranspose2d)):
                # PyTorch takes the second dimension as the inputs, also of transposed convolutions, where it is not.
                bound = 1.0 / math.sqrt(layer.weight[0].numel())
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.uniform_(-bound, bound, generator=generator)


def _run(layers: nn.Sequential, inputs: torch.Tensor, linear: Linear) -> torch.Tensor:
    for layer in layers:
        inputs = linear(layer, inputs) if isinstance(layer, nn.Linear) else layer(inputs)
    return inputs


def _first_layer(
    layer: nn.Linear, shared: torch.Tensor, states: torch.Tensor, linear: Linear = nn.Linear.__call__
) -> torch.Tensor:
    """layer([shared, states]) without repeating one shared row (1, F) for every state (B, D). -> (B, O)."""
    if len(shared) == len(states):
        return linear(layer, torch.cat((shared, states), dim=1))
    width = shared.shape[1]
    return functional.linear(shared, layer.weight[:, :width], layer.bias) + functional.linear(
        states, layer.weight[:, width:]
    )


def _perceptron(sizes: List[int]) -> nn.Sequential:
    layers: List[nn.Module] = []
    for inputs, outputs in zip(sizes, sizes[1:]):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def _image_encoder(config: ModelConfig) -> nn.Sequential:
    channels = (IMAGE_CHANNELS, *config.channels)
    layers: List[nn.Module] = []
    for inputs, outputs, kernel, stride in zip(channels, channels[1:], config.kernels, config.strides):
        layers += [nn.Conv2d(inputs, outputs, kernel, stride), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def _image_decoder(config: ModelConfig, sizes: List[Size]) -> nn.Sequential:
    """The encoder mirrored; the output padding makes each stage as large as what the encoder's stage was given."""
    channels = (IMAGE_CHANNELS, *config.channels)
    layers: List[nn.Module] = []
    for index in reversed(range(len(config.kernels))):
        kernel, stride = config.kernels[index], config.strides[index]
        padding = tuple((length - kernel) % stride for length in sizes[index])
        layers.append(nn.ConvTranspose2d(channels[index + 1], channels[index], kernel, stride, output_padding=padding))
        layers.append(nn.ReLU())
    return nn.Sequential(*layers[:-1])
