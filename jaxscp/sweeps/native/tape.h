// A tape: operations on numbers, each for the intervals of a pack at once. ``tape.py`` records them.
#pragma once

#include <algorithm>
#include <cmath>

#include "pack.h"

namespace jaxscp {

// As in ``tape.py``.
enum Code {
  kSum, kDifference, kProduct, kReciprocal, kNegative, kChoice, kMultiplyAdd, kMultiplySubtract,
  kSqrt, kSin, kCos, kExp, kLog, kTanh, kMax, kMin, kAbs, kLess, kLessEqual, kGreater, kGreaterEqual, kEqual,
};

struct Operation {
  int code, to, a, b, c;
};

template <typename Function>
inline Pack each(Pack v, Function function) {
  for (int lane = 0; lane < kWidth; ++lane) set(v, lane, function(get(v, lane)));
  return v;
}

inline Pack truth(Mask mask) { return where(mask, all(1.0), all(0.0)); }

inline void play(const Operation* at, const Operation* end, Pack* v) {
  for (; at != end; ++at) {
    const Pack &a = v[at->a], &b = v[at->b], &c = v[at->c];
    Pack& to = v[at->to];
    switch (at->code) {
      case kSum: to = a + b; break;
      case kDifference: to = a - b; break;
      case kProduct: to = a * b; break;
      case kReciprocal: to = 1.0 / a; break;
      case kNegative: to = -a; break;
      case kChoice: to = where(a != 0.0, b, c); break;
      case kMultiplyAdd: to = a * b + c; break;
      case kMultiplySubtract: to = c - a * b; break;
      case kSqrt: to = root(a); break;
      case kSin: to = each(a, [](double x) { return std::sin(x); }); break;
      case kCos: to = each(a, [](double x) { return std::cos(x); }); break;
      case kExp: to = each(a, [](double x) { return std::exp(x); }); break;
      case kLog: to = each(a, [](double x) { return std::log(x); }); break;
      case kTanh: to = each(a, [](double x) { return std::tanh(x); }); break;
      case kMax: to = where(a != a, a, larger(b, a)); break;  // no number stays none
      case kMin: to = where(a != a, a, smaller(b, a)); break;
      case kAbs: to = magnitude(a); break;
      case kLess: to = truth(a < b); break;
      case kLessEqual: to = truth(a <= b); break;
      case kGreater: to = truth(a > b); break;
      case kGreaterEqual: to = truth(a >= b); break;
      case kEqual: to = truth(a == b); break;
    }
  }
}

}  // namespace jaxscp
