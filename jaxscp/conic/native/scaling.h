// Nesterov-Todd scaling of an iterate.
#pragma once

#include "cones.h"
#include "program.h"

namespace jaxscp {

// Nesterov-Todd scaling of the product cone, without the zero cone.
class Scaling {
 public:
  Packs w;    // ConeVector: (s / y)^1/2 of half-spaces, w of second-order cones
  Packs eta;  // eta of each second-order cone

  Scaling(const Program& p, Arena& arena)
      : w(arena.take(p.packs * p.cone.size)), eta(arena.take(p.packs * p.cone_count)), program_(p) {}

  // Scaling of the cone's identity, as slack and as multiplier.
  JAXSCP_CALLED void set_unit() {
    parallel_for(w.size, [&](int i) { w[i] = all(0.0); });
    parallel_for(eta.size, [&](int i) { eta[i] = all(1.0); });
    program_.each([&](int p, int i) { at(w, p)[i] = all(1.0); },
                  [&](int p, int i, int, int) { at(w, p)[i] = all(1.0); });
  }

  JAXSCP_CALLED void set(Packs s, Packs y) {
    program_.each([&](int p, int i) { at(w, p)[i] = root(at(s, p)[i] * inverse(at(y, p)[i])); },
                  [&](int p, int i, int d, int c) {
                    soc::ConeRegisters point = soc::output(at(w, p) + i, d);
                    soc::scaling(soc::load(at(s, p) + i, d), soc::load(at(y, p) + i, d), point,
                                 eta.of(p, program_.cone_count)[c]);
                    soc::store(point, at(w, p) + i);
                  });
  }

  Pack eta_of(int p, int cone) const { return eta.of(p, program_.cone_count)[cone]; }

 private:
  Entries at(Packs v, int p) const { return program_.of_cones(v, p); }

  const Program& program_;
};

}  // namespace jaxscp
