"""Convolutions, reconstruction errors and products of matrices on the compiled kernels, shared among threads."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import Callable, DefaultDict, Iterable, List, NamedTuple, Sequence, Tuple

import torch
from torch import nn

from embodied_active_learning.model.cvae import IMAGE_CHANNELS, ConditionalVAE
from embodied_active_learning.model.native.kernels import Chain, Gradients, Kernels, Layer, Room
from embodied_active_learning.model.objective import Images

Pair = Tuple[torch.Tensor, torch.Tensor]
Task = Tuple[torch.Tensor, torch.Tensor, torch.Tensor]
Job = Callable[[], None]

PARTS = 2  # of a product for each thread: when one of them is held up, the others take over
SMALL = 1 << 24  # multiplications that one thread has done before another would have woken up


class Seen(NamedTuple):
    """What the encoder's gradients need of a batch of images; values: of each group, still borrowed."""

    images: Images
    parameters: List[torch.Tensor]
    chain: Chain
    values: List[Room]


class LookedBack(NamedTuple):
    """Gradients of the encoder's weights and biases, and what else was multiplied, with the sum of all its elements."""

    gradients: List[torch.Tensor]
    products: List[torch.Tensor]
    sum: torch.Tensor


class Errors(NamedTuple):
    """Mean squared error (B,) of each decoded image, and the gradients of the decoder's parameters by group."""

    each: torch.Tensor
    by_group: Gradients

    def gradients(self) -> Tuple[List[torch.Tensor], torch.Tensor]:
        """The gradients of the decoder's weights and biases, in their order, and the sum of all their elements."""
        found, total = self.by_group.summed()
        return _inwards(found), total


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
        self.feature_size = network.feature_size
        self._deep = range(min(kernels.near, len(self.layers)), len(self.layers) + 1)
        self._spare: DefaultDict[range, List[Room]] = defaultdict(list)

    def look(self, network: ConditionalVAE, images: Images, rows: torch.Tensor, columns: torch.Tensor) -> Seen:
        """Images (B of them) -> features, into rows (B, F) and into columns (F, B).

        What is returned goes to look_back; the images must stay as they are until then.
        """
        parameters = list(network.image_encoder.parameters())
        chain = self.encoder_chain(network)
        values = [self.borrow(self.inwards) for _ in range(self._groups(len(images)))]

        def encode(group: int, members: slice) -> None:
            self.kernels.encode(chain, images[members], values[group], rows[members], columns.t()[members])

        self.for_each_group(len(images), encode)
        return Seen(images, parameters, chain, values)

    def look_back(
        self, seen: Seen, slopes: torch.Tensor, pairs: Sequence[Pair] = (), extra: Sequence[Job] = ()
    ) -> LookedBack:
        """Slopes (B, F) at the features -> gradients of the encoder's weights and biases, in their order.

        pairs: of products that can wait until now. In small pieces, they keep all threads busy to the end. extra: what
        else is to be done until then, by whichever thread is free.
        """
        gradients = Gradients(seen.parameters, len(seen.values))
        products, tasks = self._divide(pairs)
        sums = [torch.zeros(())] * len(tasks)

        def differentiate(group: int, members: slice) -> None:
            values, flow = seen.values[group], self.borrow(self._deep)
            arguments = seen.images[members], values, flow, slopes[members], gradients.of(group)
            self.kernels.encode_back(seen.chain, *arguments)
            self.give_back(flow, self._deep)
            self.give_back(values, self.inwards)

        def multiply(index: int) -> None:
            left, right, out = tasks[index]
            self._multiply(left, right, out)
            sums[index] = out.sum()  # here, where it is in the cache

        multiplications = [partial(multiply, index) for index in range(len(tasks))]
        self._share([*self._of_groups(len(seen.images), differentiate), *multiplications, *extra])
        found, total = gradients.summed()
        return LookedBack(found, products, total + sum(sums))

    def reconstruct(
        self,
        network: ConditionalVAE,
        features: torch.Tensor,
        images: Images,
        weights: torch.Tensor,
        slopes: torch.Tensor,
        extra: Sequence[Job] = (),
    ) -> Errors:
        """Decode features (F, B), compare with images, and come back.

        Fills slopes (F, B), and returns gradients, with those of the errors' sum weighted by weights (B,). extra: as in
        look_back.
        """
        pixels, parameters = images[0].numel(), _inwards(network.image_decoder.parameters())
        chain, scales, errors = self.decoder_chain(network), weights * (2.0 / pixels), torch.empty(len(images))
        gradients = Gradients(parameters, self._groups(len(images)))

        def compare(group: int, members: slice) -> None:
            rooms = self.borrow(self._deep), self.borrow(self._deep)
            target = images[members], scales[members]
            results = slopes.t()[members], errors[members], gradients.of(group)
            self.kernels.decode_back(chain, features.t()[members], *target, rooms, *results)
            for room in rooms:
                self.give_back(room, self._deep)

        self._share([*self._of_groups(len(images), compare), *extra])
        return Errors(errors / pixels, gradients)

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """layer(inputs), inputs (B, I) -> (B, O)."""
        return self.product(layer.weight, inputs.t().contiguous()).add_(layer.bias[:, None]).t()

    def product(self, left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        """Product (M, N) of left (M, K), any strides, and right (K, N), contiguous, on all threads."""
        (found,), tasks = self._divide([(left, right)])
        self._share([partial(self._multiply, *task) for task in tasks])
        return found

    def encoder_chain(self, network: ConditionalVAE) -> Chain:
        """The convolutions of an image encoder of this geometry."""
        return self.kernels.pack(self.layers, list(network.image_encoder.parameters()))

    def decoder_chain(self, network: ConditionalVAE) -> Chain:
        """The transposed convolutions of an image decoder of this geometry."""
        return self.kernels.pack(self.layers, _inwards(network.image_decoder.parameters()))

    def for_each_group(self, count: int, task: Callable[[int, slice], None]) -> None:
        """Call task(group, its images) for the groups of `count` images, on all threads."""
        self._share(self._of_groups(count, task))

    @property
    def inwards(self) -> range:
        """All sides but the image's."""
        return range(1, len(self.layers) + 1)

    def borrow(self, sides: range) -> Room:
        """Room for one group's values on some sides of the layers, counted from the image.

        Given back, it is used again: fresh memory of this size costs more in page faults than the arithmetic.
        """
        try:
            return self._spare[sides].pop()
        except IndexError:
            return self.kernels.room(self.layers, sides)

    def give_back(self, room: Room, sides: range) -> None:
        """Return what was borrowed."""
        self._spare[sides].append(room)

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

    def _of_groups(self, count: int, task: Callable[[int, slice], None]) -> List[Job]:
        """task(group, its images) for each of the groups of `count` images."""
        return [partial(task, group, self._members(group)) for group in range(self._groups(count))]

    def _share(self, jobs: Sequence[Job]) -> None:
        """Call all of them, each by whichever thread is free; the caller is one of them."""
        left, asked_only = iter(jobs), torch.is_inference_mode_enabled()

        def work() -> None:
            with torch.inference_mode(asked_only), torch.no_grad():  # for this thread, whichever it is
                for job in left:
                    job()

        helping = [self._pool.submit(work) for _ in range(min(len(jobs), self.threads) - 1)]
        try:
            work()
        finally:
            wait(helping)
        for helper in helping:
            helper.result()


def _inwards(parts: Iterable[torch.Tensor]) -> List[torch.Tensor]:
    """Weight, bias, weight, bias, ... of a decoder's layers in the order from the image inwards, or back."""
    listed = list(parts)
    return [part for pair in zip(listed[-2::-2], listed[::-2]) for part in pair]
