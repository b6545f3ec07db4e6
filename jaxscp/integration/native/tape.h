// Evaluation of a tape: operations on numbers, each for two packs of intervals. ``tape.py`` records them, in runs of
// equal operations.
#pragma once

#include <algorithm>
#include <cmath>

#include "pack.h"

namespace jaxscp {

// One number for each of kLanes intervals, in two registers: decoding an operation takes longer than one register's
// arithmetic.
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

// In the order of ``tape.py``.
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

// function(a, b), register by register.
template <typename Function>
inline Wide both(const Wide& a, const Wide& b, Function function) {
  return {function(a.low, b.low), function(a.high, b.high)};
}

inline Pack truth(Mask mask) { return where(mask, all(1.0), all(0.0)); }

// Evaluates function(a, b, c) for the run of equal operations that begins at ``at``; returns the end of the run.
template <typename Function>
inline const Operation* run(const Operation* at, const Operation* end, Wide* v, Function function) {
  const int code = at->code;
  do v[at->to] = function(v[at->a], v[at->b], v[at->c]);
  while (++at != end && at->code == code);
  return at;
}

inline void evaluate(const Operation* at, const Operation* end, Wide* v) {
  typedef const Wide& In;
  auto all_with = [&](auto function) { at = run(at, end, v, function); };
  auto of_one = [&](auto function) { all_with([=](In a, In, In) { return each(a, function); }); };
  auto of_two = [&](auto function) { all_with([=](In a, In b, In) { return both(a, b, function); }); };
  while (at != end) switch (at->code) {
      case kSum: all_with([](In a, In b, In) { return a + b; }); break;
      case kDifference: all_with([](In a, In b, In) { return a - b; }); break;
      case kProduct: all_with([](In a, In b, In) { return a * b; }); break;
      case kReciprocal: all_with([](In a, In, In) { return Wide{1.0 / a.low, 1.0 / a.high}; }); break;
      case kNegative: all_with([](In a, In, In) { return Wide{-a.low, -a.high}; }); break;
      case kChoice: all_with([](In a, In b, In c) {
        return Wide{where(a.low != 0.0, b.low, c.low), where(a.high != 0.0, b.high, c.high)};
      }); break;
      case kMultiplyAdd: all_with([](In a, In b, In c) { return a * b + c; }); break;
      case kMultiplySubtract: all_with([](In a, In b, In c) { return c - a * b; }); break;
      case kSqrt: all_with([](In a, In, In) { return Wide{root(a.low), root(a.high)}; }); break;
      case kSin: of_one([](double x) { return std::sin(x); }); break;
      case kCos: of_one([](double x) { return std::cos(x); }); break;
      case kExp: of_one([](double x) { return std::exp(x); }); break;
      case kLog: of_one([](double x) { return std::log(x); }); break;
      case kTanh: of_one([](double x) { return std::tanh(x); }); break;
      // NaN if either operand is NaN
      case kMax: of_two([](Pack x, Pack y) { return where(x != x, x, where(y <= x, x, y)); }); break;
      case kMin: of_two([](Pack x, Pack y) { return where(x != x, x, where(y >= x, x, y)); }); break;
      case kAbs: all_with([](In a, In, In) { return Wide{magnitude(a.low), magnitude(a.high)}; }); break;
      case kLess: of_two([](Pack x, Pack y) { return truth(x < y); }); break;
      case kLessEqual: of_two([](Pack x, Pack y) { return truth(x <= y); }); break;
      case kGreater: of_two([](Pack x, Pack y) { return truth(x > y); }); break;
      case kGreaterEqual: of_two([](Pack x, Pack y) { return truth(x >= y); }); break;
      case kEqual: of_two([](Pack x, Pack y) { return truth(x == y); }); break;
    }
}

}  // namespace jaxscp
