// Pairs of bodies of a robot: how far they are from each other, and whether all are far enough.
#pragma once
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "gjk.hpp"
#include "kinematics.hpp"

namespace coopqp {

// By how much the two bounds of a distance may differ that counts as known [m].
constexpr double KNOWN = 1e-7;
// By how much a plane may be of no unit normal [m]: of rounding.
constexpr double ROUNDED = 1e-12;

// A body that is fixed to a joint; -1: to the world.
struct Solid {
    int joint;
    Placement at;
    Convex convex;
    // How fast each joint, at speed 1, moves any of its points at most; 0 where it moves none.
    std::vector<double> max_point_speeds;
};

// Nothing of it changes: where the bodies are is told by `poses`, which several threads may have of
// their own.
class Apart {
  public:
    Apart(std::vector<Solid> solids, std::vector<std::pair<int, int>> pairs)
        : solids_(std::move(solids)) {
        for (const auto& [a, b] : pairs) {
            const bool turned = of(a).radius < of(b).radius;  // the larger one's box is looked at
            pairs_.push_back({a, b, turned ? b : a, turned ? a : b, of(a).radius + of(b).radius});
        }
    }

    std::size_t size() const { return pairs_.size(); }
    const std::vector<Solid>& solids() const { return solids_; }
    const Solid& first(std::size_t k) const { return solids_[std::size_t(pairs_[k].a)]; }
    const Solid& second(std::size_t k) const { return solids_[std::size_t(pairs_[k].b)]; }
    int first_of(std::size_t k) const { return pairs_[k].a; }
    int second_of(std::size_t k) const { return pairs_[k].b; }

    // Where the bodies are.
    void place(const Kinematics& kinematics, std::vector<Pose>& poses) const {
        poses.resize(solids_.size());
        for (std::size_t i = 0; i < solids_.size(); i++) {
            const Solid& s = solids_[i];
            poses[i] = pose_of(s.joint < 0 ? placed(s.at)
                                           : placed(kinematics.joint(std::size_t(s.joint)), s.at));
        }
    }

    // Whether the balls round two bodies show that they are farther apart than d.
    bool balls_beyond(std::size_t k, const std::vector<Pose>& poses, double d) const {
        const Pair& pair = pairs_[k];
        const V3 way = poses[std::size_t(pair.a)].p - poses[std::size_t(pair.b)].p;
        const double reach = pair.reach + d;
        return dot(way, way) > reach * reach;
    }

    // Whether the box round the larger one and the ball round the other do.
    bool box_beyond(std::size_t k, const std::vector<Pose>& poses, double d) const {
        const Pair& pair = pairs_[k];
        const Pose& box = poses[std::size_t(pair.box)];
        const V3 way = box.in(poses[std::size_t(pair.ball)].p - box.p), half = of(pair.box).half;
        const double x = std::max(std::fabs(way.x) - half.x, 0.0),
                     y = std::max(std::fabs(way.y) - half.y, 0.0),
                     z = std::max(std::fabs(way.z) - half.z, 0.0);
        const double reach = of(pair.ball).radius + d;
        return x * x + y * y + z * z > reach * reach;
    }

    // As coopqp::closest.
    Closest measure(std::size_t k, const std::vector<Pose>& poses, double enough,
                    double near = -std::numeric_limits<double>::infinity()) const {
        const Pair& pair = pairs_[k];
        return closest(of(pair.a), poses[std::size_t(pair.a)], of(pair.b),
                       poses[std::size_t(pair.b)], enough, near);
    }

    // The plane that has separated a pair last, by its normal in the first body's axes, and the
    // bodies' corners next to it.
    struct Plane {
        V3 n{};
        int i = -1, j = -1;
    };

    // Whether all pairs are proved to be farther apart than d; planes, one a pair, are tried first
    // and kept for places nearby.
    bool free(const std::vector<Pose>& poses, double d, std::vector<Plane>& planes) const {
        planes.resize(pairs_.size());
        for (std::size_t k = 0; k < pairs_.size(); k++) {
            if (balls_beyond(k, poses, d) || box_beyond(k, poses, d)) continue;
            if (plane_beyond(k, poses, d, planes[k])) continue;
            const Closest found = measure(k, poses, d, d);
            planes[k].n = poses[std::size_t(pairs_[k].a)].in(found.n);
            if (found.told == Closest::Told::Beyond) continue;
            if (found.told != Closest::Told::Measured || !(found.d - found.gap > d)) return false;
        }
        return true;
    }

  private:
    struct Pair {
        int a, b, box, ball;
        double reach;  // of both balls
    };

    // Whether the plane shows that two bodies are farther apart than d.
    bool plane_beyond(std::size_t k, const std::vector<Pose>& poses, double d, Plane& plane) const {
        if (!(dot(plane.n, plane.n) > 0.5)) return false;  // there is none yet
        const Convex &A = of(pairs_[k].a), &B = of(pairs_[k].b);
        const Pose X = relative(poses[std::size_t(pairs_[k].a)], poses[std::size_t(pairs_[k].b)]);
        const V3 a = A.support(plane.n, plane.i), b = B.support(X.in(-plane.n), plane.j);
        return dot(plane.n, X.out(b) + X.p - a) - A.rim - B.rim > d + ROUNDED;
    }

    const Convex& of(int solid) const { return solids_[std::size_t(solid)].convex; }

    std::vector<Solid> solids_;
    std::vector<Pair> pairs_;
};

// Pairs that are to be farther apart than a distance.
struct KeptApart {
    Apart pairs;
    double distance;
};

// Whether configurations of a robot keep all distances. One for each thread; model and pairs, which
// outlive it, may be shared.
class FreeSpace {
  public:
    FreeSpace(const Model& model, const std::vector<KeptApart>& kept)
        : kept_(kept), kinematics_(model), planes_(kept.size()) {}

    bool free(const double* q) {
        kinematics_.place(q);
        return free(kinematics_);
    }

    // The same where the joints have been placed already.
    bool free(const Kinematics& kinematics) {
        for (std::size_t i = 0; i < kept_.size(); i++) {
            kept_[i].pairs.place(kinematics, poses_);
            if (!kept_[i].pairs.free(poses_, kept_[i].distance, planes_[i])) return false;
        }
        return true;
    }

    // Tell of every pair, those of one limit after those of another.
    template <class Tell>
    void measure(const double* q, Tell tell) {
        kinematics_.place(q);
        for (const KeptApart& each : kept_) {
            each.pairs.place(kinematics_, poses_);
            for (std::size_t k = 0; k < each.pairs.size(); k++)
                tell(each.pairs.measure(k, poses_, std::numeric_limits<double>::infinity()));
        }
    }

  private:
    const std::vector<KeptApart>& kept_;
    Kinematics kinematics_;
    std::vector<Pose> poses_;
    std::vector<std::vector<Apart::Plane>> planes_;
};

}  // namespace coopqp
