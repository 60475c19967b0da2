/* A fake device that rejects the same operations as CUDA: it has memory of its own as far as torch knows, and mixing its
 * tensors with CPU tensors is an error. It computes on the CPU, synchronously. For torch 2.4 to 2.13. */
#include <ATen/EmptyTensor.h>
#include <ATen/detail/PrivateUse1HooksInterface.h>
#include <ATen/native/CPUFallback.h>
#include <ATen/ops/_fused_adam.h>
#include <ATen/ops/_reshape_alias_native.h>
#include <ATen/ops/as_strided_native.h>
#include <ATen/ops/convolution.h>
#include <ATen/ops/convolution_backward.h>
#include <ATen/ops/from_blob.h>
#include <ATen/ops/resize_native.h>
#include <ATen/ops/view_native.h>
#include <c10/core/impl/DeviceGuardImplInterface.h>
#include <c10/core/impl/alloc_cpu.h>
#include <torch/library.h>

namespace {

constexpr c10::DeviceType TYPE = c10::DeviceType::PrivateUse1;
constexpr c10::DispatchKeySet KEYS(c10::DispatchKey::PrivateUse1);

c10::Device device() { return {TYPE, 0}; }

struct Memory final : c10::Allocator {
    c10::DataPtr allocate(size_t size) override {
        void *memory = c10::alloc_cpu(size);
        return {memory, memory, &c10::free_cpu, device()};
    }
    c10::DeleterFnPtr raw_deleter() const override { return &c10::free_cpu; }
    void copy_data(void *to, const void *from, std::size_t size) const override { default_copy_data(to, from, size); }
};

Memory memory;
REGISTER_ALLOCATOR(TYPE, &memory);

/* Functions without `override` do not exist in every version of torch. */
struct Guard final : c10::impl::DeviceGuardImplInterface {
    c10::DeviceType type() const override { return TYPE; }
    c10::Device exchangeDevice(c10::Device) const override { return device(); }
    c10::Device getDevice() const override { return device(); }
    void setDevice(c10::Device) const override {}
    void uncheckedSetDevice(c10::Device) const noexcept override {}
    c10::DeviceIndex deviceCount() const noexcept override { return 1; }
    c10::Stream getStream(c10::Device) const noexcept override { return only_stream(); }
    c10::Stream getDefaultStream(c10::Device) const override { return only_stream(); }
    c10::Stream exchangeStream(c10::Stream) const noexcept override { return only_stream(); }
    bool queryStream(const c10::Stream &) const override { return true; }
    void synchronizeStream(const c10::Stream &) const override {}
    void synchronizeDevice(const c10::DeviceIndex) const {}
    void record(void **, const c10::Stream &, const c10::DeviceIndex, const c10::EventFlag) const override {}
    void block(void *, const c10::Stream &) const override {}
    bool queryEvent(void *) const override { return true; }
    void synchronizeEvent(void *) const {}

   private:
    static c10::Stream only_stream() { return c10::Stream(c10::Stream::DEFAULT, device()); }
};

C10_REGISTER_GUARD_IMPL(PrivateUse1, Guard);

struct Hooks final : at::PrivateUse1HooksInterface {
    bool isBuilt() const { return true; }
    bool isAvailable() const { return true; }
    bool hasPrimaryContext(c10::DeviceIndex) const override { return true; }
};

const bool registered = (at::RegisterPrivateUse1HooksInterface(new Hooks), true);

/* A CPU tensor that shares the memory. */
at::Tensor on_cpu(const at::Tensor &tensor) {
    if (!tensor.defined() || tensor.is_cpu()) return tensor;
    return at::from_blob(tensor.data_ptr(), tensor.sizes(), tensor.strides(), tensor.options().device(at::kCPU));
}

at::Tensor on_device(const at::Tensor &tensor) { return tensor.defined() ? tensor.to(device()) : tensor; }

at::Tensor empty(c10::IntArrayRef size, std::optional<at::ScalarType> type, std::optional<at::Layout>,
                 std::optional<at::Device>, std::optional<bool>, std::optional<at::MemoryFormat> format) {
    return at::detail::empty_generic(size, &memory, KEYS, c10::dtype_or_default(type), format);
}

at::Tensor empty_strided(c10::IntArrayRef size, c10::IntArrayRef stride, std::optional<at::ScalarType> type,
                         std::optional<at::Layout>, std::optional<at::Device>, std::optional<bool>) {
    return at::detail::empty_strided_generic(size, stride, &memory, KEYS, c10::dtype_or_default(type));
}

at::Tensor copy_from(const at::Tensor &from, const at::Tensor &to, bool) {
    on_cpu(to).copy_(on_cpu(from));
    return to;
}

at::Tensor copy_from_and_resize(const at::Tensor &from, const at::Tensor &to) {
    to.resize_(from.sizes());
    return copy_from(from, to, false);
}

at::Scalar number(const at::Tensor &tensor) { return on_cpu(tensor).item(); }

at::Tensor convolution(const at::Tensor &input, const at::Tensor &weight, const std::optional<at::Tensor> &bias,
                       c10::IntArrayRef stride, c10::IntArrayRef padding, c10::IntArrayRef dilation, bool transposed,
                       c10::IntArrayRef output_padding, int64_t groups) {
    at::Tensor offset = bias ? on_cpu(*bias) : at::Tensor();
    return on_device(at::convolution(on_cpu(input), on_cpu(weight), offset, stride, padding, dilation, transposed,
                                     output_padding, groups));
}

std::tuple<at::Tensor, at::Tensor, at::Tensor> convolution_backward(
    const at::Tensor &gradients, const at::Tensor &input, const at::Tensor &weight, c10::IntArrayRef stride,
    c10::IntArrayRef padding, c10::IntArrayRef dilation, bool transposed, c10::IntArrayRef output_padding,
    int64_t groups, std::array<bool, 3> wanted) {
    int64_t biases = transposed ? weight.size(1) * groups : weight.size(0);
    auto [inputs, weights, offsets] =
        at::convolution_backward(on_cpu(gradients), on_cpu(input), on_cpu(weight), biases, stride, padding, dilation,
                                 transposed, output_padding, groups, wanted);
    return {on_device(inputs), on_device(weights), on_device(offsets)};
}

/* torch 2.4 cannot fall back to the CPU for operations that change lists of tensors. */
void fused_adam(at::TensorList weights, at::TensorList gradients, at::TensorList means, at::TensorList squares,
                at::TensorList largest, at::TensorList steps, double rate, double beta1, double beta2, double decay,
                double epsilon, bool amsgrad, bool maximise, const std::optional<at::Tensor> &scale,
                const std::optional<at::Tensor> &infinite) {
    std::vector<at::Tensor> lists[6];
    const at::TensorList given[6] = {weights, gradients, means, squares, largest, steps};
    for (int i = 0; i < 6; i++)
        for (const at::Tensor &tensor : given[i]) lists[i].push_back(on_cpu(tensor));
    at::_fused_adam_(lists[0], lists[1], lists[2], lists[3], lists[4], lists[5], rate, beta1, beta2, decay, epsilon,
                     amsgrad, maximise, scale, infinite);
}

void refuse_cpu(const at::Tensor &tensor, const c10::OperatorHandle &operation) {
    TORCH_CHECK(!tensor.defined() || !tensor.is_cpu() || tensor.dim() == 0, "a tensor of the CPU in ",
                operation.schema().operator_name(), " on another device");
}

void run_on_cpu(const c10::OperatorHandle &operation, torch::jit::Stack *stack) {
    for (const c10::IValue &value : torch::jit::last(*stack, operation.schema().arguments().size())) {
        if (value.isTensor()) refuse_cpu(value.toTensor(), operation);
        if (value.isTensorList())
            for (const at::Tensor &tensor : value.toTensorVector()) refuse_cpu(tensor, operation);
    }
    at::native::cpu_fallback(operation, stack);
}

TORCH_LIBRARY_IMPL(aten, PrivateUse1, m) {
    m.impl("empty.memory_format", &empty);
    m.impl("empty_strided", &empty_strided);
    m.impl("_copy_from", &copy_from);
    m.impl("_copy_from_and_resize", &copy_from_and_resize);
    m.impl("_local_scalar_dense", &number);
    m.impl("convolution_overrideable", &convolution);
    m.impl("convolution_backward_overrideable", &convolution_backward);
    m.impl("_fused_adam_", &fused_adam);
    m.impl("as_strided", &at::native::as_strided_tensorimpl);
    m.impl("view", &at::native::view);
    m.impl("_reshape_alias", &at::native::_reshape_alias);
    m.impl("resize_", &at::native::resize_);
}

TORCH_LIBRARY_IMPL(_, PrivateUse1, m) { m.fallback(torch::CppFunction::makeFromBoxedFunction<&run_on_cpu>()); }

}  // namespace
