// A tape: operations on numbers, each for sixteen intervals at once. ``tape.py`` records them.
#pragma once

#include <algorithm>
#include <cmath>

#include "pack.h"

namespace jaxscp {

// A number of the mathematics, for sixteen intervals: in two registers, as it takes longer to look up an operation than
// to do it once.
struct Wide {
  Pack low, high;
};
constexpr int kLanes = 2 * kWidth;

inline double get(const Wide& v, int lane) { return get(lane < kWidth ? v.low : v.high, lane % kWidth); }
inline void set(Wide& v, int lane, double to) { set(lane < kWidth ? v.low : v.high, lane % kWidth, to); }

inline Wide wide(double v) { return {all(v), all(v)}; }
inline Wide operator+(Wide a, Wide b) { return {a.low + b.low, a.high + b.high}; }
inline Wide operator-(Wide a, Wide b) { return {a.low - b.low, a.high - b.high}; }
inline Wide operator*(Wide a, Wide b) { return {a.low * b.low, a.high * b.high}; }
inline Wide operator*(double a, Wide b) { return {a * b.low, a * b.high}; }
inline Wide& operator+=(Wide& a, Wide b) { return a = a + b; }

// As in ``tape.py``.
enum Code {
  kSum, kDifference, kProduct, kReciprocal, kNegative, kChoice, kMultiplyAdd, kMultiplySubtract,
  kSqrt, kSin, kCos, kExp, kLog, kTanh, kMax, kMin, kAbs, kLess, kLessEqual, kGreater, kGreaterEqual, kEqual,
};

struct Operation {
  int code, to, a, b, c;
};

template <typename Function>
inline Wide each(const Wide& v, Function function) {
  Wide to;
  for (int lane = 0; lane < kLanes; ++lane) set(to, lane, function(get(v, lane)));
  return to;
}

// function(a, b) of both registers.
template <typename Function>
inline Wide both(const Wide& a, const Wide& b, Function function) {
  return {function(a.low, b.low), function(a.high, b.high)};
}

inline Pack truth(Mask mask) { return where(mask, all(1.0), all(0.0)); }

inline void play(const Operation* at, const Operation* end, Wide* v) {
  for (; at != end; ++at) {
    const Wide a = v[at->a], b = v[at->b], c = v[at->c];
    Wide& to = v[at->to];
    switch (at->code) {
      case kSum: to = a + b; break;
      case kDifference: to = a - b; break;
      case kProduct: to = a * b; break;
      case kReciprocal: to = {1.0 / a.low, 1.0 / a.high}; break;
      case kNegative: to = {-a.low, -a.high}; break;
      case kChoice: to = {where(a.low != 0.0, b.low, c.low), where(a.high != 0.0, b.high, c.high)}; break;
      case kMultiplyAdd: to = a * b + c; break;
      case kMultiplySubtract: to = c - a * b; break;
      case kSqrt: to = {root(a.low), root(a.high)}; break;
      case kSin: to = each(a, [](double x) { return std::sin(x); }); break;
      case kCos: to = each(a, [](double x) { return std::cos(x); }); break;
      case kExp: to = each(a, [](double x) { return std::exp(x); }); break;
      case kLog: to = each(a, [](double x) { return std::log(x); }); break;
      case kTanh: to = each(a, [](double x) { return std::tanh(x); }); break;
      // no number stays none, whichever it is
      case kMax: to = both(a, b, [](Pack x, Pack y) { return where(x != x, x, where(y <= x, x, y)); }); break;
      case kMin: to = both(a, b, [](Pack x, Pack y) { return where(x != x, x, where(y >= x, x, y)); }); break;
      case kAbs: to = {magnitude(a.low), magnitude(a.high)}; break;
      case kLess: to = both(a, b, [](Pack x, Pack y) { return truth(x < y); }); break;
      case kLessEqual: to = both(a, b, [](Pack x, Pack y) { return truth(x <= y); }); break;
      case kGreater: to = both(a, b, [](Pack x, Pack y) { return truth(x > y); }); break;
      case kGreaterEqual: to = both(a, b, [](Pack x, Pack y) { return truth(x >= y); }); break;
      case kEqual: to = both(a, b, [](Pack x, Pack y) { return truth(x == y); }); break;
    }
  }
}

}  // namespace jaxscp
