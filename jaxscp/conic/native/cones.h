// Second-order cones {(t, v): |v| <= t}, one per stage of a pack, and their Nesterov-Todd scaling. Formulas and sources
// are those of ``cones/second_order.py``. Results may overwrite arguments.
#pragma once

#include "cone_registers.h"

namespace jaxscp::soc {

constexpr double kTiny = 1e-300;

inline Pack dot(const ConeRegisters& a, const ConeRegisters& b) {
  return total(a.d, [&](int i) { return a[i] * b[i]; });
}
inline Pack tail_dot(const ConeRegisters& a, const ConeRegisters& b) {
  return tail_total(a.d, [&](int i) { return a[i] * b[i]; });
}

inline Pack positive(Pack v) { return larger(v, all(kTiny)); }

inline Pack tail_norm(const ConeRegisters& v) { return root(tail_dot(v, v)); }

// t^2 - |v|^2, as a product because the difference of squares cancels near the boundary.
inline Pack determinant(const ConeRegisters& v) {
  Pack norm = tail_norm(v), t = head(v);
  return (t - norm) * (t + norm);
}

// out = a o b - minus e
inline void product(const ConeRegisters& a, const ConeRegisters& b, Pack minus, ConeRegisters& out) {
  Pack along = dot(a, b), a0 = head(a), b0 = head(b);
  each(out, [&](int i) { return a0 * b[i] + b0 * a[i]; });
  set_head(out, along - minus);
}

// The u with a o u = b, for a inside the cone.
inline void divide(const ConeRegisters& a, const ConeRegisters& b, ConeRegisters& out) {
  Pack a0 = head(a), first = (a0 * head(b) - tail_dot(a, b)) * inverse(positive(determinant(a)));
  Pack over = inverse(a0);
  each(out, [&](int i) { return (b[i] - first * a[i]) * over; });
  set_head(out, first);
}

// 1 / (largest step that stays in the cone); not positive if every step does.
inline Pack inverse_step(const ConeRegisters& point, const ConeRegisters& direction) {
  Pack over = inverse_root(positive(determinant(point)));
  Pack p0 = head(point) * over, d0 = head(direction) * over;
  Pack first = p0 * d0 - tail_dot(point, direction) * over * over;
  Pack factor = (first + d0) * inverse(p0 + 1.0);
  Pack square = tail_total(point.d, [&](int i) {
    Pack tail = (direction[i] - factor * point[i]) * over;
    return tail * tail;
  });
  return root(square) - first;
}

// W = eta Wbar; W^2 = eta^2 (2 w w' - J).
inline void scaling(const ConeRegisters& s, const ConeRegisters& y, ConeRegisters& w, Pack& eta) {
  Pack det_s = positive(determinant(s)), det_y = positive(determinant(y));
  Pack over_s = inverse_root(det_s), over_y = inverse_root(det_y);
  Pack gamma = root(0.5 * (1.0 + dot(s, y) * over_s * over_y));
  Pack half = 0.5 * inverse(gamma);
  each(w, [&](int i) { return (s[i] * over_s - y[i] * over_y) * half; });
  set_head(w, (head(s) * over_s + head(y) * over_y) * half);
  eta = root(root(det_s * inverse(det_y)));
}

// W v, or W^-1 v for sign = -1.
inline void scale(const ConeRegisters& w, Pack eta, double sign, const ConeRegisters& v, ConeRegisters& out) {
  Pack along = tail_dot(w, v), v0 = head(v), w0 = head(w);
  Pack by = sign > 0 ? eta : inverse(eta);
  Pack factor = sign * v0 + along * inverse(1.0 + w0);
  each(out, [&](int i) { return by * (v[i] + w[i] * factor); });
  set_head(out, by * (w0 * v0 + sign * along));
}

// W^2 v.
inline void square(const ConeRegisters& w, Pack eta, const ConeRegisters& v, ConeRegisters& out) {
  Pack by = eta * eta, along = 2.0 * dot(w, v), first = by * (head(w) * along - head(v));
  each(out, [&](int i) { return by * (w[i] * along + v[i]); });
  set_head(out, first);
}

// The head of W^2 v.
inline Pack square_head(const ConeRegisters& w, Pack eta, const ConeRegisters& v) {
  return eta * eta * (head(w) * 2.0 * dot(w, v) - head(v));
}

// v'W^2 v.
inline Pack scaled_square(const ConeRegisters& w, Pack eta, const ConeRegisters& v) {
  Pack along = dot(w, v), v0 = head(v);
  return eta * eta * (2.0 * along * along - v0 * v0 + tail_dot(v, v));
}

// W^-2 v.
inline void inverse_square(const ConeRegisters& w, Pack eta, const ConeRegisters& v, ConeRegisters& out) {
  Pack w0 = head(w), v0 = head(v);
  Pack by = inverse(eta * eta), along = 2.0 * (w0 * v0 - tail_dot(w, v));
  each(out, [&](int i) { return by * (v[i] - w[i] * along); });
  set_head(out, by * (w0 * along - v0));
}

// (W^2)_{11}^-1 v for w's tail, split along and across the tail because the eigenvalues differ by 1 + 2 |tail|^2.
inline void tail_inverse(const ConeRegisters& tail, Pack eta, const ConeRegisters& v, ConeRegisters& out) {
  Pack size = dot(tail, tail), over = inverse_root(positive(size));
  Pack part = dot(tail, v) * over;
  each(out, [&](int i) { return v[i] - tail[i] * over * part; });
  Pack remainder = dot(tail, out) * over;  // removes the rounding of the first projection
  Pack by = inverse(eta * eta), shrunk = part * inverse(1.0 + 2.0 * size) - remainder;
  each(out, [&](int i) { return by * (out[i] + tail[i] * over * shrunk); });
}

}  // namespace jaxscp::soc
