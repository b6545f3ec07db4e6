// Second-order cones {(t, v): |v| <= t}, one of each pack's places, and their Nesterov-Todd scaling. Formulas and
// sources are those of ``cones.py``.
#pragma once

#include "arena.h"
#include "threads.h"

namespace jaxscp::soc {

constexpr double kTiny = 1e-300;

inline Pack dot(Entries a, Entries b, int size) {
  return sum(0, size, [&](int i) { return a[i] * b[i]; });
}

inline Pack positive(Pack v) { return larger(v, all(kTiny)); }

inline Pack tail_norm(Entries v, int d) { return root(dot(v + 1, v + 1, d - 1)); }

// t^2 - |v|^2, as a product because the difference of squares cancels near the boundary.
inline Pack determinant(Entries v, int d) {
  Pack norm = tail_norm(v, d);
  return (v[0] - norm) * (v[0] + norm);
}

// out = a o b - less e
inline void product(Entries a, Entries b, int d, Pack less, Entries out) {
  Pack head = dot(a, b, d), a0 = a[0], b0 = b[0];
  put(out, 1, d, [&](int i) { return a0 * b[i] + b0 * a[i]; });
  out[0] = head - less;
}

// The u with a o u = b, for a inside the cone.
inline void divide(Entries a, Entries b, int d, Entries out) {
  Pack head = (a[0] * b[0] - dot(a + 1, b + 1, d - 1)) / positive(determinant(a, d));
  Pack over = 1.0 / a[0];
  put(out, 1, d, [&](int i) { return (b[i] - head * a[i]) * over; });
  out[0] = head;
}

// Largest step from a point that stays in the cone.
inline Pack step_to_boundary(Entries point, Entries direction, int d) {
  Pack over = 1.0 / root(positive(determinant(point, d)));
  Pack p0 = point[0] * over, d0 = direction[0] * over;
  Pack head = p0 * d0 - dot(point + 1, direction + 1, d - 1) * over * over;
  Pack share = (head + d0) / (p0 + 1.0);
  Pack square = sum(1, d, [&](int i) {
    Pack tail = (direction[i] - share * point[i]) * over;
    return tail * tail;
  });
  return 1.0 / positive(root(square) - head);
}

// W = eta Wbar; W^2 = eta^2 (2 w w' - J).
inline void scaling(Entries s, Entries y, int d, Entries w, Pack& eta) {
  Pack det_s = positive(determinant(s, d)), det_y = positive(determinant(y, d));
  Pack over_s = 1.0 / root(det_s), over_y = 1.0 / root(det_y);
  Pack gamma = root(0.5 * (1.0 + dot(s, y, d) * over_s * over_y));
  Pack half = 0.5 / gamma;
  w[0] = (s[0] * over_s + y[0] * over_y) * half;
  put(w, 1, d, [&](int i) { return (s[i] * over_s - y[i] * over_y) * half; });
  eta = root(root(det_s / det_y));
}

// W v, or W^-1 v for sign = -1.
inline void scale(Entries w, Pack eta, double sign, Entries v, int d, Entries out) {
  Pack along = dot(w + 1, v + 1, d - 1), v0 = v[0];
  Pack by = sign > 0 ? eta : 1.0 / eta;
  Pack share = sign * v0 + along / (1.0 + w[0]);
  put(out, 1, d, [&](int i) { return by * (v[i] + w[i] * share); });
  out[0] = by * (w[0] * v0 + sign * along);
}

// W^2 v.
inline void square(Entries w, Pack eta, Entries v, int d, Entries out) {
  Pack by = eta * eta, along = 2.0 * dot(w, v, d);
  out[0] = by * (w[0] * along - v[0]);
  put(out, 1, d, [&](int i) { return by * (w[i] * along + v[i]); });
}

// v'W^2 v.
inline Pack scaled_square(Entries w, Pack eta, Entries v, int d) {
  Pack along = dot(w, v, d), tail = dot(v + 1, v + 1, d - 1);
  return eta * eta * (2.0 * along * along - v[0] * v[0] + tail);
}

// W^-2 v.
inline void inverse_square(Entries w, Pack eta, Entries v, int d, Entries out) {
  Pack by = 1.0 / (eta * eta), along = 2.0 * (w[0] * v[0] - dot(w + 1, v + 1, d - 1));
  out[0] = by * (w[0] * along - v[0]);
  put(out, 1, d, [&](int i) { return by * (v[i] - w[i] * along); });
}

// (W^2)_{11}^-1 v, split along and across w1 because the two parts differ by the square of |w1|.
inline void tail_inverse(Entries w, Pack eta, Entries v, int d, Entries out) {
  Entries w1 = w + 1;
  Pack size = dot(w1, w1, d), over = 1.0 / root(positive(size));
  Pack part = dot(w1, v, d) * over;
  put(out, 0, d, [&](int i) { return v[i] - w1[i] * over * part; });
  Pack rest = dot(w1, out, d) * over;  // twice is enough
  Pack by = 1.0 / (eta * eta), shrunk = part / (1.0 + 2.0 * size) - rest;
  put(out, 0, d, [&](int i) { return by * (out[i] + w1[i] * over * shrunk); });
}

}  // namespace jaxscp::soc
