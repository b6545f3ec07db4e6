// A call from XLA: its arguments, results, attributes, threads and stream.
//
// XLA's interface in C is stable for a year or more, so a copy of its header builds libraries for every jaxlib that
// pyproject.toml admits. XLA's header for C++ needs a jaxlib, and takes two to four seconds in every source.
#pragma once

#include <cstdint>
#include <cstring>
#include <exception>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "xla_c_api.h"  // of jaxlib 0.9.0: later ones take it too

namespace jaxscp {

// What prevents a call. XLA shows the text to the user.
struct CallError {
  XLA_FFI_Error_Code code;
  std::string text;
};
inline CallError invalid(std::string text) { return {XLA_FFI_Error_Code_INVALID_ARGUMENT, std::move(text)}; }
inline CallError internal(std::string text) { return {XLA_FFI_Error_Code_INTERNAL, std::move(text)}; }

// XLA's name of a type of numbers.
template <typename Number>
constexpr XLA_FFI_DataType type_of() {
  if constexpr (std::is_same_v<Number, double>) return XLA_FFI_DataType_F64;
  if constexpr (std::is_same_v<Number, bool>) return XLA_FFI_DataType_PRED;
  if constexpr (std::is_same_v<Number, uint8_t>) return XLA_FFI_DataType_U8;
  if constexpr (std::is_same_v<Number, int32_t>) return XLA_FFI_DataType_S32;
  if constexpr (std::is_same_v<Number, int64_t> || std::is_same_v<Number, long long>) return XLA_FFI_DataType_S64;
  return XLA_FFI_DataType_INVALID;
}

// An argument, or a result.
class Array {
 public:
  explicit Array(const void* buffer) : buffer_(static_cast<const XLA_FFI_Buffer*>(buffer)) {}

  void* address() const { return buffer_->data; }
  int64_t rank() const { return buffer_->rank; }
  int64_t length(int64_t axis) const { return buffer_->dims[axis]; }
  int64_t size() const {
    int64_t product = 1;
    for (int64_t axis = 0; axis < rank(); ++axis) product *= length(axis);
    return product;
  }
  // Length of an axis counted from the end: 1 is the last one.
  int from_last(int64_t axis) const {
    if (axis > rank()) throw invalid("an array lacks an axis");
    return static_cast<int>(length(rank() - axis));
  }
  template <typename Number>
  Number* numbers() const {
    if (buffer_->dtype != type_of<Number>()) throw invalid("an array has another type of numbers");
    return static_cast<Number*>(buffer_->data);
  }

 private:
  const XLA_FFI_Buffer* buffer_;
};

class Call {
 public:
  explicit Call(const XLA_FFI_CallFrame* frame) : frame_(*frame) {}
  ~Call() {
    for (const auto& [data, size] : scratch_) {
      auto wish = asked<XLA_FFI_DeviceMemory_Free_Args>(XLA_FFI_DeviceMemory_Free_Args_STRUCT_SIZE);
      wish.size = size, wish.data = data;
      succeeds(frame_.api->XLA_FFI_DeviceMemory_Free(&wish));
    }
  }
  Call(const Call&) = delete;

  int64_t arguments() const { return frame_.args.size; }
  int64_t results() const { return frame_.rets.size; }
  void expect(int64_t arguments, int64_t results) const {
    if (arguments != this->arguments()) throw invalid("a call lacks an argument, or has too many");
    if (results != this->results()) throw invalid("a call lacks a result, or has too many");
  }
  Array argument(int64_t i) const {
    if (i >= arguments()) throw invalid("a call lacks an argument");
    return Array(frame_.args.args[i]);
  }
  Array result(int64_t i) const {
    if (i >= results()) throw invalid("a call lacks a result");
    return Array(frame_.rets.rets[i]);
  }

  template <typename Number>
  Number number(std::string_view name) const {
    const auto* scalar = static_cast<const XLA_FFI_Scalar*>(attribute(name, XLA_FFI_AttrType_SCALAR));
    if (scalar->dtype != type_of<Number>()) throw invalid(std::string(name) + " is another type of number");
    return *static_cast<const Number*>(scalar->value);
  }
  template <typename Number>
  std::span<const Number> numbers(std::string_view name) const {
    const auto* array = static_cast<const XLA_FFI_Array*>(attribute(name, XLA_FFI_AttrType_ARRAY));
    if (array->dtype != type_of<Number>()) throw invalid(std::string(name) + " has another type of numbers");
    return {static_cast<const Number*>(array->data), array->size};
  }
  std::string_view text(std::string_view name) const {
    const auto* bytes = static_cast<const XLA_FFI_ByteSpan*>(attribute(name, XLA_FFI_AttrType_STRING));
    return {bytes->ptr, bytes->len};
  }

  // Number of XLA's threads on a CPU; one if XLA has no threads to lend.
  int64_t threads() const {
    int64_t count = 1;
    auto wish = asked<XLA_FFI_ThreadPool_NumThreads_Args>(XLA_FFI_ThreadPool_NumThreads_Args_STRUCT_SIZE);
    wish.num_threads = &count;
    succeeds(frame_.api->XLA_FFI_ThreadPool_NumThreads(&wish));
    return count;
  }
  // Runs work() on one of XLA's threads, or on this one if XLA has none.
  template <typename Work>
  void schedule(Work work) const {
    auto wish = asked<XLA_FFI_ThreadPool_Schedule_Args>(XLA_FFI_ThreadPool_Schedule_Args_STRUCT_SIZE);
    wish.data = new Work(std::move(work));
    wish.task = [](void* data) {
      Work* const mine = static_cast<Work*>(data);
      (*mine)();
      delete mine;
    };
    if (!succeeds(frame_.api->XLA_FFI_ThreadPool_Schedule(&wish))) wish.task(wish.data);
  }

  // Stream of a GPU on which the call has to work.
  void* stream() const {
    auto wish = asked<XLA_FFI_Stream_Get_Args>(XLA_FFI_Stream_Get_Args_STRUCT_SIZE);
    if (!succeeds(frame_.api->XLA_FFI_Stream_Get(&wish))) throw internal("XLA has no stream for a call");
    return wish.stream;
  }
  // Memory of the GPU until the end of this call; null if there is not enough.
  void* allocate(size_t size, size_t alignment) {
    auto wish = asked<XLA_FFI_DeviceMemory_Allocate_Args>(XLA_FFI_DeviceMemory_Allocate_Args_STRUCT_SIZE);
    wish.size = size, wish.alignment = alignment;
    if (!succeeds(frame_.api->XLA_FFI_DeviceMemory_Allocate(&wish))) return nullptr;
    scratch_.emplace_back(wish.data, size);
    return wish.data;
  }

 private:
  // Arguments of a function of XLA's.
  template <typename Wish>
  Wish asked(size_t size) const {
    Wish wish{};
    wish.struct_size = size, wish.ctx = frame_.ctx;
    return wish;
  }
  bool succeeds(XLA_FFI_Error* error) const {
    if (!error) return true;
    XLA_FFI_Error_Destroy_Args wish{XLA_FFI_Error_Destroy_Args_STRUCT_SIZE, nullptr, error};
    frame_.api->XLA_FFI_Error_Destroy(&wish);
    return false;
  }
  const void* attribute(std::string_view name, XLA_FFI_AttrType type) const {
    for (int64_t i = 0; i < frame_.attrs.size; ++i)
      if (name == std::string_view(frame_.attrs.names[i]->ptr, frame_.attrs.names[i]->len)) {
        if (frame_.attrs.types[i] != type) throw invalid(std::string(name) + " is another kind of attribute");
        return frame_.attrs.attrs[i];
      }
    throw invalid("a call lacks the attribute " + std::string(name));
  }

  const XLA_FFI_CallFrame& frame_;
  std::vector<std::pair<void*, size_t>> scratch_;
};

// Tells XLA for which version of its interface a handler was compiled.
inline void describe(XLA_FFI_Metadata* about) {
  about->api_version = {XLA_FFI_Api_Version_STRUCT_SIZE, nullptr, XLA_FFI_API_MAJOR, XLA_FFI_API_MINOR};
  about->traits = 0;
}

// Answers a call from XLA by act(call).
inline XLA_FFI_Error* answer(XLA_FFI_CallFrame* frame, void (*act)(Call&)) {
  if (XLA_FFI_Extension_Base* asked = frame->extension_start; asked && asked->type == XLA_FFI_Extension_Metadata) {
    describe(reinterpret_cast<XLA_FFI_Metadata_Extension*>(asked)->metadata);
    return nullptr;
  }
  CallError error;
  try {
    if (frame->stage != XLA_FFI_ExecutionStage_EXECUTE) throw invalid("a handler was called before its execution");
    Call call(frame);
    act(call);
    return nullptr;
  } catch (const CallError& raised) {
    error = raised;
  } catch (const std::exception& raised) {
    error = internal(raised.what());
  }
  XLA_FFI_Error_Create_Args wish{XLA_FFI_Error_Create_Args_STRUCT_SIZE, nullptr, error.text.c_str(), error.code};
  return frame->api->XLA_FFI_Error_Create(&wish);
}

}  // namespace jaxscp

// Exports act(call) under a name that JAX can register.
#define JAXSCP_HANDLER(name, act) \
  extern "C" XLA_FFI_Error* name(XLA_FFI_CallFrame* frame) { return jaxscp::answer(frame, act); }
