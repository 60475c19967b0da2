"""The conditional variational autoencoder: image at a state -> latents -> image at any state. Paper, Table 2."""

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


def clamped(logarithm: torch.Tensor) -> torch.Tensor:
    """Clamp a log std or log variance to LOG_LIMITS, which keeps its exponential finite."""
    return logarithm.clamp(*LOG_LIMITS)


def clamp_mask(logarithm: torch.Tensor) -> torch.Tensor:
    """Return the derivative of clamped(), as booleans."""
    return (logarithm >= LOG_LIMITS[0]) & (logarithm <= LOG_LIMITS[1])


def latent_gaussian(outputs: torch.Tensor) -> LatentGaussian:
    """Split the encoder's outputs (B, 2 L) into means and log variances."""
    mean, log_variance = outputs.chunk(2, dim=1)
    return LatentGaussian(mean, clamped(log_variance))


def convolution_sizes(image_size: Size, config: ModelConfig) -> List[Size]:
    """Return (height, width) of the image and of each convolution's output.

    Raises:
        ConfigError: The image is too small for the convolutions.
    """
    sizes = [(int(image_size[0]), int(image_size[1]))]
    for index, (kernel, stride) in enumerate(zip(config.kernels, config.strides)):
        if min(sizes[-1]) < kernel:
            raise ConfigError(
                f"image too small for the model: camera/height x camera/width = {image_size[0]} x {image_size[1]} gives"
                f" {sizes[-1][0]} x {sizes[-1][1]} for convolution {index + 1}, whose kernel is {kernel}; enlarge the"
                " image or change model/kernels and model/strides"
            )
        height, width = sizes[-1]
        sizes.append(((height - kernel) // stride + 1, (width - kernel) // stride + 1))
    return sizes


def float_images(images: torch.Tensor, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """Convert images (B, H, W, 3) uint8 to (B, 3, H, W) in [0, 1], channels last in memory."""
    return images.permute(0, 3, 1, 2).to(dtype).div_(255.0)


class ConditionalVAE(nn.Module):
    """CVAE with one observation log std per image: encoder q(z | x, y), decoder p(y | z, x). Paper, Sec. 3 and Table 2.

    4,309,220 parameters for 180 x 180 images and 3 states.

    Args:
        image_size: (height, width) in pixels.
        state_size: Number D of normalised state dimensions.
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
        """Return q(z | x, y), (B, L), of images y (B, H, W, 3) uint8 at states x (B, D) normalised."""
        return self.encode_features(states, self.image_features(images))

    def image_features(self, images: torch.Tensor) -> torch.Tensor:
        """Return image features (B, F), which do not depend on the state, of images (B, H, W, 3) uint8."""
        return self.image_encoder(float_images(images, self.encoder[0].weight.dtype)).flatten(1)

    def encode_features(
        self, states: torch.Tensor, features: torch.Tensor, linear: Linear = nn.Linear.__call__
    ) -> LatentGaussian:
        """Return q(z | x, y), (B, L), at states (B, D) from image features (B, F), or (1, F) for all states.

        linear: Applies a layer to its inputs.
        """
        first = _first_layer(self.encoder[0], features, states, linear)
        return latent_gaussian(_run(self.encoder[1:], first, linear))

    def decode(self, latents: torch.Tensor, states: torch.Tensor) -> Tuple[torch.Tensor, torch.Tensor]:
        """Return mean image (B, 3, H, W) and log std (B,) of p(y | z, x), for latents (B, L) and states (B, D)."""
        log_std, features = self.decode_features(latents, states)
        return self.image_decoder(features.unflatten(1, self.feature_shape)), log_std

    def set_initial_colour(self, colour: torch.Tensor) -> None:
        """Set the bias of the decoder's last layer to a colour (3,) in [0, 1].

        From black, the first hundreds of updates only learn the images' brightness, and objects may share one colour
        for thousands more.
        """
        with torch.no_grad():
            self.image_decoder[-1].bias.copy_(colour)

    def decode_features(
        self, latents: torch.Tensor, states: torch.Tensor, linear: Linear = nn.Linear.__call__
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        """Return log std (B,) and the image decoder's input (B, F), for latents (B, L) and states (B, D).

        linear: Applies a layer to its inputs.
        """
        outputs = _run(self.decoder, torch.cat((latents, states), dim=1), linear)
        return clamped(outputs[:, 0]), outputs[:, 1:]

    def log_std(self, latents: torch.Tensor, states: torch.Tensor) -> torch.Tensor:
        """Return the log std (S,) of p(y | z, s) at states s (S, D), for latents (S, L), (1, L) or (L,).

        Skips the image and the F outputs that lead to it: the conditional entropy (Paper, Eq. 29) needs the std only.
        """
        hidden = _first_layer(self.decoder[0], latents.reshape(-1, self.latent_size), states)
        hidden = self.decoder[1:-1](hidden)
        head = self.decoder[-1]
        return clamped(functional.linear(hidden, head.weight[:1], head.bias[:1])[:, 0])


def initialise(network: nn.Module, generator: torch.Generator) -> None:
    """Apply PyTorch's default initialisation, U(-1/sqrt(fan_in), 1/sqrt(fan_in)), from a given generator."""
    with torch.no_grad():
        for layer in network.modules():
            if isinstance(layer, (nn.Linear, nn.Conv2d, nn.ConvTranspose2d)):
                # As PyTorch does, which takes dimension 1 for the inputs of transposed convolutions as well.
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
    """Return layer([shared, states]) (B, O) without repeating a single shared row (1, F) for each state (B, D)."""
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
    """Mirror the encoder; output padding makes each output as large as the corresponding input of the encoder."""
    channels = (IMAGE_CHANNELS, *config.channels)
    layers: List[nn.Module] = []
    for index in reversed(range(len(config.kernels))):
        kernel, stride = config.kernels[index], config.strides[index]
        padding = tuple((length - kernel) % stride for length in sizes[index])
        layers.append(nn.ConvTranspose2d(channels[index + 1], channels[index], kernel, stride, output_padding=padding))
        layers.append(nn.ReLU())
    return nn.Sequential(*layers[:-1])
