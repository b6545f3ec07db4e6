// Parts of the work at one stage.
#pragma once

namespace jaxscp {

// Items for one thread each, then second-order cones, whose entries several lanes of a GPU share, then more items.
struct Parts {
  int single, cones = 0, rest = 0;
  int count() const { return single + cones + rest; }
};

}  // namespace jaxscp
