// The distance of two convex bodies, with a bound of its own error, by the method of Gilbert, Johnson
// and Keerthi (1988).
//
// Of the points b - a of two bodies one is nearest to the origin. The simplex that it is looked for
// with is of such points, so that its own nearest point v bounds the distance from above; the
// farthest points along v lie on planes that separate the bodies, and bound it from below.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>

#include "convex.hpp"

namespace coopqp {

constexpr int MOST_TURNS = 128;
constexpr double CLOSED = 1e-12, CLOSED_ROUND = 1e-10;  // between the bounds of a distance [m]
constexpr double FINE = 1e-9;     // between those that nothing is tried anew for
constexpr double TOUCHING = 1e-12;  // a distance of bodies without their rims that is none
constexpr int MOST_RESTARTS = 4;

struct Closest {
    enum class Told {
        Measured,
        Beyond,  // farther apart than was asked for; d is a lower bound
        Within,  // nearer than was asked for; d is an upper bound
        Inside,  // in each other, without their rims; not proved
    };
    Told told = Told::Inside;
    double d = 0.0;
    double gap = std::numeric_limits<double>::infinity();  // the distance is between d - gap and d
    V3 p{}, n{};  // nearest point of the first body; unit normal towards the second, also Beyond
};

// Up to four points b - a, and the weights of the one nearest to the origin.
class Simplex {
  public:
    struct Vertex {
        V3 w, a;  // b - a, and a
    };

    int count() const { return count_; }
    void begin(const Vertex& w) {
        s_[0] = w;
        l_[0] = 1.0;
        count_ = 1;
    }
    bool has(const Vertex& w) const {
        for (int i = 0; i < count_; i++)
            if (s_[i].w == w.w && s_[i].a == w.a) return true;
        return false;
    }

    // Add a point, and keep those that carry the nearest one. False where the origin is inside.
    bool add(const Vertex& w) {
        s_[count_++] = w;
        if (count_ == 2) return line(), true;
        if (count_ == 3) return triangle(), true;
        return tetrahedron();
    }

    V3 nearest() const { return weighted(&Vertex::w); }
    V3 nearest_of_first() const { return weighted(&Vertex::a); }

  private:
    V3 weighted(V3 Vertex::*of) const {
        V3 sum = l_[0] * (s_[0].*of);
        for (int i = 1; i < count_; i++) sum = sum + l_[i] * (s_[i].*of);
        return sum;
    }

    void keep(int i) {
        const Vertex one = s_[i];
        begin(one);
    }
    void keep(int i, int j, double share) {
        const Vertex one = s_[i], other = s_[j];
        s_[0] = one;
        s_[1] = other;
        l_[0] = 1.0 - share;
        l_[1] = share;
        count_ = 2;
    }

    void line() {
        const V3 along = s_[1].w - s_[0].w;
        const double t = -dot(s_[0].w, along), size2 = dot(along, along);
        if (t <= 0.0 || size2 <= 0.0) return keep(0);
        if (t >= size2) return keep(1);
        keep(0, 1, t / size2);
    }

    // By the regions of Voronoi, as in Ericson, Real-Time Collision Detection, 5.1.5.
    void triangle() {
        const V3 &a = s_[0].w, &b = s_[1].w, &c = s_[2].w, ab = b - a, ac = c - a;
        const double d1 = -dot(ab, a), d2 = -dot(ac, a);
        if (d1 <= 0.0 && d2 <= 0.0) return keep(0);
        const double d3 = -dot(ab, b), d4 = -dot(ac, b);
        if (d3 >= 0.0 && d4 <= d3) return keep(1);
        const double of_c = d1 * d4 - d3 * d2;
        if (of_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0) return keep(0, 1, d1 / (d1 - d3));
        const double d5 = -dot(ab, c), d6 = -dot(ac, c);
        if (d6 >= 0.0 && d5 <= d6) return keep(2);
        const double of_b = d5 * d2 - d1 * d6;
        if (of_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0) return keep(0, 2, d2 / (d2 - d6));
        const double of_a = d3 * d6 - d5 * d4, up = d4 - d3, down = d5 - d6;
        if (of_a <= 0.0 && up >= 0.0 && down >= 0.0) return keep(1, 2, up / (up + down));
        const double by = 1.0 / (of_a + of_b + of_c);
        l_[1] = of_b * by;
        l_[2] = of_c * by;
        l_[0] = 1.0 - l_[1] - l_[2];
        count_ = 3;
    }

    // A tetrahedron that is nearly flat is never said to have the origin inside.
    bool tetrahedron() {
        static constexpr int FACES[4][4] = {{0, 1, 2, 3}, {0, 2, 3, 1}, {0, 3, 1, 2}, {1, 3, 2, 0}};
        double largest = 0.0, least = std::numeric_limits<double>::infinity();
        for (const Vertex& v : s_) largest = std::max(largest, dot(v.w, v.w));
        bool inside = true;
        Simplex best, face;
        for (const auto& f : FACES) {
            const V3& a = s_[f[0]].w;
            const V3 n = cross(s_[f[1]].w - a, s_[f[2]].w - a);
            const double origin = -dot(a, n), fourth = dot(s_[f[3]].w - a, n);
            if (origin * fourth > 0.0 && fourth * fourth > FLAT * dot(n, n) * largest) continue;
            inside = false;
            for (int i = 0; i < 3; i++) face.s_[i] = s_[f[i]];
            face.count_ = 3;
            face.triangle();
            const V3 v = face.nearest();
            const double d2 = dot(v, v);
            if (d2 < least) {
                least = d2;
                best = face;
            }
        }
        if (inside || !best.count_) return false;
        *this = best;
        return true;
    }

    static constexpr double FLAT = 1e-20;  // square of a height, relative to the largest point
    Vertex s_[4] = {};
    double l_[4] = {};
    int count_ = 0;
};

// Of A and B, each where it is. It begins at their middles, so that the same poses give the same
// digits. Told early where the bodies are farther apart than `enough`, or nearer than `near`.
inline Closest closest(const Convex& A, const Pose& at_A, const Convex& B, const Pose& at_B,
                       double enough, double near = -std::numeric_limits<double>::infinity()) {
    using Told = Closest::Told;
    const Pose X = relative(at_A, at_B);  // all is in A's frame
    const double rims = A.rim + B.rim, closed = A.round() || B.round() ? CLOSED_ROUND : CLOSED;
    V3 v = X.p, n = {1.0, 0.0, 0.0};  // of the best plane, which is the one that is proved
    if (!(dot(v, v) > 0.0)) v = {1.0, 0.0, 0.0};
    double size = std::sqrt(dot(v, v)), low = -std::numeric_limits<double>::infinity();
    Simplex simplex, best;
    double best_size = std::numeric_limits<double>::infinity();
    Closest found;
    int i = -1, j = -1, restarts = 0;
    for (int turn = 0; turn < MOST_TURNS; turn++) {
        Simplex::Vertex w;
        w.a = A.support(v, i);
        w.w = X.out(B.support(X.in(-v), j)) + X.p - w.a;
        if (const double here = dot(v, w.w) / size; here > low) {
            low = here;
            n = (1.0 / size) * v;
        }
        if (low - rims > enough) {
            found.told = Told::Beyond;
            found.d = low - rims;
            found.n = at_A.out(n);
            return found;
        }
        if (simplex.count()) {
            if (best_size - low <= closed) break;
            if (simplex.has(w)) {  // digits run out
                if (best_size - low <= FINE || restarts++ >= MOST_RESTARTS) break;
                simplex = Simplex();
            }
        }
        const bool first = !simplex.count();
        if (first)
            simplex.begin(w);
        else if (!simplex.add(w))
            return found;
        V3 next = simplex.nearest();
        double next2 = dot(next, next);
        if (!first && !(next2 < size * size)) {  // the same
            if (best_size - low <= FINE || restarts++ >= MOST_RESTARTS) break;
            simplex.begin(w);
            next = w.w;
            next2 = dot(next, next);
        }
        v = next;
        size = std::sqrt(next2);
        if (size < TOUCHING) return found;
        if (size < best_size) {
            best_size = size;
            best = simplex;
        }
        if (size - rims <= near) {
            found.told = Told::Within;
            found.d = size - rims;
            return found;
        }
    }
    if (!best.count()) return found;  // poses that are no numbers
    found.told = Told::Measured;
    found.d = best_size - rims;
    found.gap = std::max(best_size - low, 0.0);
    found.n = at_A.out(n);
    found.p = at_A.out(best.nearest_of_first() + A.rim * n) + at_A.p;
    return found;
}

}  // namespace coopqp
