// Arrays that are allocated once: after a reset, the same arrays are taken again in the same order.
#pragma once

#include <cstddef>
#include <vector>

namespace jaxscp {

template <typename T>
class WorkspaceOf {
 public:
  void reset() { next_ = 0; }
  T* take(size_t count) {
    if (next_ == arrays_.size()) arrays_.emplace_back();
    auto& array = arrays_[next_++];
    if (array.size() < count) array.resize(count);
    return array.data();
  }

 private:
  std::vector<std::vector<T>> arrays_;
  size_t next_ = 0;
};

}  // namespace jaxscp
