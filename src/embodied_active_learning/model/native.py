"""Convolutions, reconstruction errors and products of matrices on the compiled kernels, shared among threads."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Callable, DefaultDict, List, NamedTuple, Sequence, Tuple

import torch
from torch import nn

from embodied_active_learning.model.cvae import IMAGE_CHANNELS, ConditionalVAE
from embodied_active_learning.model.kernels import EndGradients, Kernels, Layer, Weights
from embodied_active_learning.model.objective import Images

Pair = Tuple[torch.Tensor, torch.Tensor]
Task = Tuple[torch.Tensor, torch.Tensor, torch.Tensor]

PARTS = 2  # of a product for each thread: when one of them is held up, the others take over
SMALL = 1 << 24  # multiplications that one thread has done before another would have woken up
END = 2  # layers next to the image that are worked off together, a few rows at a time


class Seen(NamedTuple):
    """What the encoder's gradients need of a batch of images; values: behind each convolution, still borrowed."""

    images: Images
    parameters: List[torch.Tensor]
    weights: List[Weights]
    values: List[torch.Tensor]


class LookedBack(NamedTuple):
    """Gradients of the encoder's weights and biases, and what else was multiplied, with the sum of all its elements."""

    gradients: List[torch.Tensor]
    products: List[torch.Tensor]
    sum: torch.Tensor


class Errors(NamedTuple):
    """Mean squared error (B,) of each decoded image, and the gradients of the decoder's weights and biases."""

    each: torch.Tensor
    gradients: List[torch.Tensor]


class NativeImages:
    """The network's convolutions in single precision, and products that are large enough to be shared."""

    def __init__(self, network: ConditionalVAE, kernels: Kernels) -> None:
        """Take over the geometry of the network; its weights are read at each call."""
        self.kernels = kernels
        self.threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1), thread_name_prefix="kernels")
        convolutions = [layer for layer in network.image_encoder if isinstance(layer, nn.Conv2d)]
        shapes = [(IMAGE_CHANNELS, *network.sizes[0])]
        shapes += [(layer.out_channels, *size) for layer, size in zip(convolutions, network.sizes[1:])]
        geometry = zip(shapes, shapes[1:], convolutions)
        self.layers = [Layer(wide, narrow, part.kernel_size[0], part.stride[0]) for wide, narrow, part in geometry]
        self._shapes = shapes
        self.feature_size = network.feature_size
        self.deep_sides = range(min(END, len(self.layers)), len(self.layers) + 1)
        self._spare: DefaultDict[Tuple[int, range], List[List[torch.Tensor]]] = defaultdict(list)

    def look(self, network: ConditionalVAE, images: Images, rows: torch.Tensor, columns: torch.Tensor) -> Seen:
        """Images (B of them) -> features, into rows (B, F) and into columns (F, B).

        What is returned goes to look_back; the images must stay as they are until then.
        """
        kernels = self.kernels
        parameters = list(network.image_encoder.parameters())
        weights = kernels.pack(self.layers, parameters)
        values = self.borrow(self._groups(len(images)), range(1, len(self.layers) + 1))

        def encode(group: int, members: slice) -> None:
            self.encode(weights, images[members], [side[group] for side in values])
            kernels.from_group(values[-1][group], rows[members])
            kernels.from_group(values[-1][group], columns.t()[members])

        self.for_each_group(len(images), encode)
        return Seen(images, parameters, weights, values)

    def look_back(self, seen: Seen, slopes: torch.Tensor, pairs: Sequence[Pair] = ()) -> LookedBack:
        """Slopes (B, F) at the features -> gradients of the encoder's weights and biases, in their order.

        pairs: of products that can wait until now. In small pieces, they keep all threads busy to the end.
        """
        kernels, layers, weights, values = self.kernels, self.layers, seen.weights, seen.values
        groups = len(values[0])
        gradients = _gradients_of(seen.parameters, groups)
        products, tasks = self._divide(pairs)
        sums = [torch.zeros(())] * len(tasks)

        def differentiate(group: int, members: slice) -> None:
            borrowed = self.borrow(1, self.deep_sides)
            parts = [part[group] for part in gradients]
            flow = borrowed[-1][0]
            kernels.to_group(slopes[members], flow)
            kernels.bias_gradient(layers[-1].narrow, flow, parts[-1])
            for i in reversed(range(END, len(layers))):
                inner = values[i - 1][group]
                kernels.weight_gradient(layers[i], flow, inner, parts[2 * i])
                below = borrowed[i - END][0]
                kernels.widen(layers[i], weights[i].without_bias, flow, below, gate=inner, totals=parts[2 * i - 1])
                flow = below
            end = parts[:3] if len(layers) > 1 else parts[:1]
            between = values[0][group] if len(layers) > 1 else None
            kernels.look_back(layers[:END], weights[:END], seen.images[members], between, flow, end)
            self.give_back(borrowed, 1, self.deep_sides)

        def work(index: int) -> None:
            if index < groups:
                differentiate(index, self._members(index))
            else:
                left, right, out = tasks[index - groups]
                self._multiply(left, right, out)
                sums[index - groups] = out.sum()  # here, where it is in the cache

        self._share(groups + len(tasks), work)
        self.give_back(values, groups, range(1, len(layers) + 1))
        return LookedBack([gradient.sum(0) for gradient in gradients], products, sum(sums, torch.zeros(())))

    def reconstruct(
        self,
        network: ConditionalVAE,
        features: torch.Tensor,
        images: Images,
        weights: torch.Tensor,
        slopes: torch.Tensor,
    ) -> Errors:
        """Decode features (F, B), compare with images, and come back.

        Fills slopes (F, B), and returns gradients, with those of the errors' sum weighted by weights (B,).
        """
        kernels, layers = self.kernels, self.layers
        pixels, is_gated = images[0].numel(), len(self.layers) > END
        parameters = list(network.image_decoder.parameters())
        packed = kernels.pack(layers[::-1], parameters)[::-1]
        scales, errors = weights[:, None] * (2.0 / pixels), torch.empty((len(images), 1))
        gradients = _gradients_of(parameters, self._groups(len(images)))

        def work(group: int, members: slice) -> None:
            values, flow = self.borrow(1, self.deep_sides), self.borrow(1, self.deep_sides)
            inner, below = [side[0] for side in values], [side[0] for side in flow]
            scale, squares = torch.empty(kernels.lanes), torch.empty(kernels.lanes)
            kernels.to_group(features.t()[members], inner[-1])
            kernels.to_group(scales[members], scale)
            # Weight and bias of each layer, from the image inwards.
            slots = [(weight[group], bias[group]) for weight, bias in zip(gradients[-2::-2], gradients[::-2])]
            totals = slots[END][1] if is_gated else torch.empty(layers[-1].narrow[0])
            found = EndGradients(squares, slots[0], slots[1] if len(slots) > 1 else None, totals)
            self.decode(packed, inner)
            image = images[members], scale
            kernels.reconstruct(layers[:END], packed[:END], inner[0], *image, is_gated, below[0], found)
            self._differentiate_decoder(packed, inner, below, slots)
            kernels.from_group(below[-1], slopes.t()[members])
            kernels.from_group(squares, errors[members])
            self.give_back(values, 1, self.deep_sides)
            self.give_back(flow, 1, self.deep_sides)

        self.for_each_group(len(images), work)
        return Errors(errors[:, 0] / pixels, [gradient.sum(0) for gradient in gradients])

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """layer(inputs), inputs (B, I) -> (B, O)."""
        return self.product(layer.weight, inputs.t().contiguous()).add_(layer.bias[:, None]).t()

    def product(self, left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        """Product (M, N) of left (M, K), any strides, and right (K, N), contiguous, on all threads."""
        (found,), tasks = self._divide([(left, right)])
        self._share(len(tasks), lambda task: self._multiply(*tasks[task]))
        return found

    def encode(self, weights: List[Weights], images: Images, sides: List[torch.Tensor]) -> None:
        """From one group's images: fill its sides, that behind the first convolution to the innermost, the features."""
        layers, count = self.layers, len(self.layers)
        self.kernels.look(layers[:END], weights[:END], images, sides[:END], relu=count > END)
        for i in range(END, count):
            self.kernels.narrow(layers[i], weights[i], sides[i - 1], sides[i], relu=i + 1 < count)

    def decode(self, weights: List[Weights], sides: List[torch.Tensor]) -> None:
        """From the innermost of one group's sides, the features: fill the others, outwards as far as there are any.

        weights: of the decoder's layers, the image's first.
        """
        nearest = len(self.layers) + 1 - len(sides)
        for i in reversed(range(nearest, len(self.layers))):
            wide, narrow = sides[i - nearest], sides[i - nearest + 1]
            self.kernels.widen(self.layers[i], weights[i], narrow, wide, relu=i > 0)

    def for_each_group(self, count: int, task: Callable[[int, slice], None]) -> None:
        """Call task(group, its images) for the groups of `count` images, on all threads."""
        self._share(self._groups(count), lambda group: task(group, self._members(group)))

    def borrow(self, groups: int, sides: range) -> List[torch.Tensor]:
        """Room for the values on some sides of the layers, counted from the image: (groups, C, H, W, lanes) each.

        Given back, it is used again: fresh memory of this size costs more in page faults than the arithmetic.
        """
        try:
            return self._spare[groups, sides].pop()
        except IndexError:
            return [torch.empty((groups, *self._shapes[side], self.kernels.lanes)) for side in sides]

    def give_back(self, buffers: List[torch.Tensor], groups: int, sides: range) -> None:
        """Return what was borrowed."""
        self._spare[groups, sides].append(buffers)

    def _divide(self, pairs: Sequence[Pair]) -> Tuple[List[torch.Tensor], List[Task]]:
        """-> room for the product of each pair, and what is to be multiplied for them."""
        found: List[torch.Tensor] = []
        tasks: List[Task] = []
        for left, right in pairs:
            (rows, _), columns = left.shape, right.shape[1]
            out = left.new_empty((rows, columns))
            found.append(out)
            if left.numel() * columns <= SMALL:
                tasks.append((left, right, out))
            elif rows > columns:
                tasks += [(left[part], right, out[part]) for part in self._parts(rows)]
            else:
                tasks += [(left, right[:, part], out[:, part]) for part in self._parts(columns)]
        return found, tasks

    def _multiply(self, left: torch.Tensor, right: torch.Tensor, out: torch.Tensor) -> None:
        # Torch's own product is far from this machine's best on some processors, but has the small ones.
        if out.shape[1] < self.kernels.panel:
            torch.mm(left, right, out=out)
        else:
            self.kernels.multiply(left, right, out)

    def _differentiate_decoder(
        self,
        packed: List[Weights],
        inner: List[torch.Tensor],
        below: List[torch.Tensor],
        slots: List[Tuple[torch.Tensor, torch.Tensor]],
    ) -> None:
        """From the slopes that the last layers leave to those at the features, with the gradients on the way."""
        kernels, count = self.kernels, len(self.layers)
        for i in range(END, count):
            layer, (wide, narrow) = self.layers[i], below[i - END : i - END + 2]
            values = inner[i - END + 1]
            kernels.weight_gradient(layer, values, wide, slots[i][0])
            gate, totals = (values, slots[i + 1][1]) if i + 1 < count else (None, None)
            kernels.narrow(layer, packed[i].without_bias, wide, narrow, gate=gate, totals=totals)

    def _groups(self, count: int) -> int:
        return -(-count // self.kernels.lanes)

    def _members(self, group: int) -> slice:
        return slice(group * self.kernels.lanes, (group + 1) * self.kernels.lanes)

    def _parts(self, count: int) -> List[slice]:
        """Parts of range(count), whole panels but for the last."""
        panel = self.kernels.panel
        parts = max(1, min(PARTS * self.threads, count // panel))
        bounds = [count * part // parts // panel * panel for part in range(parts)] + [count]
        return [slice(*pair) for pair in zip(bounds, bounds[1:])]

    def _share(self, count: int, task: Callable[[int], None]) -> None:
        """Call task(0), ..., task(count - 1), each by whichever thread is free; the caller is one of them."""
        left, asked_only = iter(range(count)), torch.is_inference_mode_enabled()

        def work() -> None:
            with torch.inference_mode(asked_only), torch.no_grad():  # for this thread, whichever it is
                for index in left:
                    task(index)

        helping = [self._pool.submit(work) for _ in range(min(count, self.threads) - 1)]
        try:
            work()
        finally:
            wait(helping)
        for helper in helping:
            helper.result()


def _gradients_of(parameters: List[torch.Tensor], groups: int) -> List[torch.Tensor]:
    """Room for the gradient of each parameter that comes from each group."""
    return [torch.empty((groups, *parameter.shape)) for parameter in parameters]
