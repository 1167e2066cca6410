// Convex bodies about the middle of the box round them, and which of their points lies farthest
// along a direction.
#pragma once
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "kinematics.hpp"
#include "shared.hpp"

namespace coopqp {

struct V3 {
    double x, y, z;
};
inline V3 operator+(const V3& a, const V3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline V3 operator-(const V3& a, const V3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline V3 operator-(const V3& a) { return {-a.x, -a.y, -a.z}; }
inline V3 operator*(double s, const V3& a) { return {s * a.x, s * a.y, s * a.z}; }
inline bool operator==(const V3& a, const V3& b) { return a.x == b.x && a.y == b.y && a.z == b.z; }
inline double dot(const V3& a, const V3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline V3 cross(const V3& a, const V3& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// Where a body is: its axes and its origin.
struct Pose {
    V3 x, y, z, p;

    V3 out(const V3& a) const {
        return {x.x * a.x + y.x * a.y + z.x * a.z, x.y * a.x + y.y * a.y + z.y * a.z,
                x.z * a.x + y.z * a.y + z.z * a.z};
    }
    V3 in(const V3& a) const { return {dot(x, a), dot(y, a), dot(z, a)}; }
};

inline V3 first_three(const v4& a) { return {a[0], a[1], a[2]}; }

inline Pose pose_of(const Frame& f) {
    return {first_three(f.x), first_three(f.y), first_three(f.z), first_three(f.p)};
}

// B as seen from A.
inline Pose relative(const Pose& A, const Pose& B) {
    return {A.in(B.x), A.in(B.y), A.in(B.z), A.in(B.p - A.p)};
}

// All is thickened by the rim: a ball is a point, a capsule two of them.
class Convex {
  public:
    Form form = Form::Hull;
    V3 half{};  // half the edges of the box round it
    double radius = 0.0, rim = 0.0;  // of the ball round it
    std::vector<V3> points;  // corners; of cylinders some of their rims

    // edges: pairs of corners of a hull; those of a few corners need none.
    void open(const std::vector<std::pair<int, int>>& edges) {
        first_.assign(points.size() + 1, 0);
        for (const auto& [a, b] : edges) {
            first_[std::size_t(a) + 1]++;
            first_[std::size_t(b) + 1]++;
        }
        for (std::size_t i = 0; i < points.size(); i++) first_[i + 1] += first_[i];
        next_.resize(2 * edges.size());
        std::vector<int> at(first_.begin(), first_.end() - 1);
        for (const auto& [a, b] : edges) {
            next_[std::size_t(at[std::size_t(a)]++)] = b;
            next_[std::size_t(at[std::size_t(b)]++)] = a;
        }
        climbs_ = form == Form::Hull && points.size() > FEW && !edges.empty();
        if (climbs_) fill_table();
    }

    bool round() const { return form == Form::Cylinder || form == Form::Ellipsoid; }

    // The farthest point along d, without the rim. at: a corner to begin at, -1 for none; becomes
    // the one that was found.
    V3 support(const V3& d, int& at) const {
        switch (form) {
            case Form::Box:
                return {d.x < 0.0 ? -half.x : half.x, d.y < 0.0 ? -half.y : half.y,
                        d.z < 0.0 ? -half.z : half.z};
            case Form::Cylinder: return of_cylinder(d);
            case Form::Ellipsoid: return of_ellipsoid(d);
            case Form::Hull: break;
        }
        at = climbs_ ? climb(d, at < 0 ? table_[std::size_t(cell(d))] : at) : scan(d);
        return points[std::size_t(at)];
    }

  private:
    V3 of_cylinder(const V3& d) const {
        const double across2 = d.x * d.x + d.y * d.y, end = d.z < 0.0 ? -half.z : half.z;
        if (across2 <= LEVEL * d.z * d.z) return {0.0, 0.0, end};
        const double by = half.x / std::sqrt(across2);
        return {by * d.x, by * d.y, end};
    }

    V3 of_ellipsoid(const V3& d) const {
        const V3 e = {half.x * d.x, half.y * d.y, half.z * d.z};
        const double by = 1.0 / std::sqrt(dot(e, e));
        return {by * half.x * e.x, by * half.y * e.y, by * half.z * e.z};
    }

    int scan(const V3& d) const {
        int best = 0;
        double most = dot(points[0], d);
        for (std::size_t i = 1; i < points.size(); i++) {
            const double far = dot(points[i], d);
            if (far > most) most = far, best = int(i);
        }
        return best;
    }

    // Along edges as long as that leads farther: on a convex body nothing is farther then.
    int climb(const V3& d, int at) const {
        double most = dot(points[std::size_t(at)], d);
        for (int from = -1; from != at;) {
            from = at;
            const int end = first_[std::size_t(from) + 1];
            for (int k = first_[std::size_t(from)]; k < end; k++) {
                const int other = next_[std::size_t(k)];
                const double far = dot(points[std::size_t(other)], d);
                if (far > most) most = far, at = other;
            }
        }
        return at;
    }

    // Which cell of a cube's six faces a direction points to.
    static int cell(const V3& d) {
        const double x = std::fabs(d.x), y = std::fabs(d.y), z = std::fabs(d.z);
        if (x >= y && x >= z) return cell(d.x < 0.0 ? 1 : 0, d.y, d.z, x);
        if (y >= z) return cell(d.y < 0.0 ? 3 : 2, d.x, d.z, y);
        return cell(d.z < 0.0 ? 5 : 4, d.x, d.y, z);
    }
    static int cell(int face, double u, double v, double most) {
        return (face * CELLS + strip(u / most)) * CELLS + strip(v / most);
    }
    static int strip(double share) {  // -1 to 1; also of what is no number
        const double at = 0.5 * CELLS * (share + 1.0);
        return at > 0.0 ? at < CELLS ? int(at) : CELLS - 1 : 0;
    }

    // The corner to begin at for each cell.
    void fill_table() {
        int at = 0;
        for (int face = 0; face < 6; face++)
            for (int i = 0; i < CELLS; i++)
                for (int j = 0; j < CELLS; j++) {
                    const double u = (2 * i + 1.0) / CELLS - 1.0, v = (2 * j + 1.0) / CELLS - 1.0;
                    const double w = face % 2 ? -1.0 : 1.0;
                    at = climb(face < 2 ? V3{w, u, v} : face < 4 ? V3{u, w, v} : V3{u, v, w}, at);
                    table_.push_back(at);
                }
    }

    static constexpr int CELLS = 8;
    static constexpr std::size_t FEW = 12;  // corners that are looked at one by one
    static constexpr double LEVEL = 1e-28;  // of a direction along a cylinder's axis
    bool climbs_ = false;
    std::vector<int> first_, next_;  // neighbours of corner i: next_[first_[i]] and on
    std::vector<int> table_;
};

}  // namespace coopqp
