// Rows of a limit that keeps pairs of bodies apart, as coopqp.limits._keep_apart has them; only of
// pairs that could need one in this tick.
//
// A pair whose distance d leaves a row -d_dot <= h that its joints, at speeds s, cannot break has none:
// d_dot is no faster than the sum of their max_point_speeds times s. An answer is asked afterwards
// whether its joints are faster than that; more pairs are looked at then.
#pragma once
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "apart.hpp"
#include "constraints.hpp"

namespace coopqp {

class Separation {
  public:
    enum class Told {
        Kept,
        More,     // there are rows now that an answer breaks
        Unknown,  // bodies are in each other, or their distance is not known
    };

    Separation(const Model& model, KeptApart kept, double gain, double within, double dt)
        : m_(model), pairs_(std::move(kept.pairs)), distance_(kept.distance), gain_(gain),
          within_(within), at_once_(1.0 / dt),
          later_(std::min(CORNERS_LATER * gain, at_once_ - gain)),
          shallow_(std::max(distance_, SHALLOW)),
          seen_(pairs_.size()), closing_(pairs_.solids().size()) {
        near_.reserve(std::min(pairs_.size(), MOST_NEAR));
    }

    // How many rows there are at most.
    int most_rows() const { return int(std::min(pairs_.size(), MOST_NEAR)) + int(CORNER_ROWS); }

    // Append the rows of this tick; speed: of joints, up to which pairs have the rows they need;
    // corners: whether the closest have theirs.
    Told begin(const Kinematics& kinematics, const double* speed, Limits& limits, bool corners) {
        pairs_.place(kinematics, poses_);
        std::fill(seen_.begin(), seen_.end(), char(0));
        near_.clear();
        if (!find(speed)) return Told::Unknown;
        for (const Near& near : near_) take(near, kinematics, limits);
        if (corners) take_corners(kinematics, limits);
        return Told::Kept;
    }

    // Append the rows that joints at a higher speed need; v: an answer, in lanes.
    Told look(const Kinematics& kinematics, const double* speed, const double* v, Limits& limits) {
        const std::size_t before = near_.size();
        if (!find(speed)) return Told::Unknown;
        Told told = Told::Kept;
        for (std::size_t i = before; i < near_.size(); i++) {
            const double* row = take(near_[i], kinematics, limits);
            if (dot(row, v, m_.blocks) > limits.h.back() + VIOLATION) told = Told::More;
        }
        return told;
    }

    // How many pairs have a row.
    std::size_t near() const { return near_.size(); }

  private:
    struct Near {
        std::size_t pair;
        Closest at;
    };

    // Measure what has not been looked at and could need a row. False where one is not known.
    bool find(const double* speed) {
        const auto& solids = pairs_.solids();
        const std::size_t n = m_.joints.size();
        for (std::size_t i = 0; i < solids.size(); i++) {
            closing_[i] = 0.0;
            for (std::size_t j = 0; j < n; j++) closing_[i] += solids[i].max_point_speeds[j] * speed[j];
        }
        for (std::size_t k = 0; k < pairs_.size(); k++) {
            // Joints that move both bodies are counted at first.
            const double most = closing_[std::size_t(pairs_.first_of(k))] +
                                closing_[std::size_t(pairs_.second_of(k))];
            if (seen_[k] || pairs_.balls_beyond(k, poses_, needed(most))) continue;
            const double d = needed(closing(k, speed));
            if (pairs_.balls_beyond(k, poses_, d) || pairs_.box_beyond(k, poses_, d)) continue;
            const Closest found = pairs_.measure(k, poses_, d);
            if (found.told == Closest::Told::Beyond) continue;
            const bool known = found.told == Closest::Told::Measured && found.gap <= KNOWN;
            if (!known || near_.size() == MOST_NEAR) return false;
            seen_[k] = 1;
            near_.push_back({k, found});
        }
        return true;
    }

    // How fast a pair can close.
    double closing(std::size_t k, const double* speed) const {
        const double *a = pairs_.first(k).max_point_speeds.data(), *b = pairs_.second(k).max_point_speeds.data();
        double all = 0.0;
        for (std::size_t j = 0; j < m_.joints.size(); j++)
            all += a[j] == 0.0 || b[j] == 0.0 ? (a[j] + b[j]) * speed[j] : 0.0;
        return all;
    }

    // The distance from which on a pair that closes so fast needs no row, nor rows of corners.
    double needed(double closing) const {
        const double slowed = gain_ * (within_ - distance_);
        const double d = closing <= slowed ? distance_ + closing / gain_
                                           : within_ + (closing - slowed) / at_once_;
        return std::max(d, distance_ + WITH_CORNERS);
    }

    // Append a pair's row.
    const double* take(const Near& near, const Kinematics& kinematics, Limits& limits) const {
        const double d = near.at.d, beyond = std::max(d - within_, 0.0);
        return append(near, near.at.p, d - distance_, beyond * (at_once_ - gain_), kinematics, limits);
    }

    // Append -d_dot <= h of what is at p, by coopqp.limit.damp and with more where it is far.
    const double* append(const Near& near, const V3& p, double margin, double more,
                         const Kinematics& kinematics, Limits& limits) const {
        double* row = limits.G + limits.h.size() * std::size_t(m_.blocks) * LANES;
        double h = (margin < -shallow_ ? 0.0 : margin * gain_) + more;
        const double sum = fill(near, p, kinematics, row);
        if (h < 0.0) h = std::max(h, -BACK * sum);
        limits.h.push_back(h);
        return row;
    }

    // -d_dot by the joints' speeds; returns the sum of their sizes.
    double fill(const Near& near, const V3& p, const Kinematics& kinematics, double* row) const {
        const double *a = pairs_.first(near.pair).max_point_speeds.data(),
                     *b = pairs_.second(near.pair).max_point_speeds.data();
        const V3& n = near.at.n;
        double sum = 0.0;
        clear(row, m_.blocks);
        for (std::size_t j = 0; j < m_.joints.size(); j++) {
            if ((a[j] == 0.0) == (b[j] == 0.0)) continue;  // it moves none of the two, or both
            const Joint& joint = m_.joints[j];
            const Frame& f = kinematics.joint(j);
            const V3 axis = first_three(f.z);
            const double by =
                joint.slides ? dot(axis, n) : dot(axis, cross(p - first_three(f.p), n));
            row[joint.lane] = b[j] == 0.0 ? by : -by;
            sum += std::fabs(by);
        }
        return sum;
    }

    // Of the closest pairs that may touch in more than one point; as coopqp.limits._keep_apart.Corners.
    void take_corners(const Kinematics& kinematics, Limits& limits) {
        close_.clear();
        for (std::size_t i = 0; i < near_.size(); i++) {
            const bool flat = pairs_.first(near_[i].pair).convex.points.size() > 1 &&
                              pairs_.second(near_[i].pair).convex.points.size() > 1;
            if (flat && near_[i].at.d - distance_ < WITH_CORNERS) close_.push_back(i);
        }
        std::stable_sort(close_.begin(), close_.end(), [this](std::size_t i, std::size_t j) {
            return near_[i].at.d < near_[j].at.d;
        });
        int left = int(CORNER_ROWS);
        for (std::size_t i : close_) {
            find_corners(near_[i]);
            for (const End& corner : corners_) {
                if (left-- == 0) return;
                const double behind = std::max(corner.height - near_[i].at.d, 0.0);
                append(near_[i], corner.p, corner.height - distance_, later_ * behind, kinematics,
                       limits);
            }
        }
    }

    struct End {
        V3 p;
        double height;  // along n; of a corner: from the plane that bounds the other body
    };

    void find_corners(const Near& near) {
        const V3& n = near.at.n;
        const std::size_t a = std::size_t(pairs_.first_of(near.pair)),
                          b = std::size_t(pairs_.second_of(near.pair));
        corners_.clear();
        ends(pairs_.solids()[a].convex, poses_[a], n, 1.0, first_);
        if (first_.size() == 1) return;  // it touches in its nearest point alone
        ends(pairs_.solids()[b].convex, poses_[b], n, -1.0, second_);
        if (second_.size() == 1) return;
        const bool of_first = width(first_) <= width(second_) + EVEN;
        double plane = of_first ? second_[0].height : first_[0].height;
        for (const End& end : of_first ? second_ : first_)
            plane = of_first ? std::min(plane, end.height) : std::max(plane, end.height);
        spread(of_first ? first_ : second_, near.at.p);
        for (End& corner : corners_)
            corner.height = of_first ? plane - corner.height : corner.height - plane;
    }

    // A body's points next to the plane that bounds it, and how high they are; out: 1 or -1.
    void ends(const Convex& convex, const Pose& pose, const V3& n, double out,
              std::vector<End>& found) {
        const V3 up = out * pose.in(n);
        heights_.resize(convex.points.size());
        double top = -std::numeric_limits<double>::infinity();
        for (std::size_t i = 0; i < convex.points.size(); i++) {
            heights_[i] = dot(convex.points[i], up);
            top = std::max(top, heights_[i]);
        }
        found.clear();
        for (std::size_t i = 0; i < convex.points.size(); i++)
            if (heights_[i] > top - CORNER_SLAB)
                found.push_back({pose.out(convex.points[i]) + pose.p,
                                 out * (heights_[i] + convex.rim) + dot(n, pose.p)});
    }

    static double width(const std::vector<End>& ends) {
        V3 low = ends[0].p, high = low;
        for (const End& end : ends) {
            low = {std::min(low.x, end.p.x), std::min(low.y, end.p.y), std::min(low.z, end.p.z)};
            high = {std::max(high.x, end.p.x), std::max(high.y, end.p.y), std::max(high.z, end.p.z)};
        }
        const V3 size = high - low;
        return std::max(size.x, std::max(size.y, size.z));
    }

    // Up to three of the points, far from p and from each other.
    void spread(const std::vector<End>& ends, const V3& p) {
        if (ends.size() <= std::size_t(CORNERS_EACH)) {
            corners_ = ends;
            return;
        }
        const std::size_t one = most(ends, [&](const V3& x) { return dot(x - p, x - p); });
        const V3& start = ends[one].p;
        const std::size_t other =
            most(ends, [&](const V3& x) { return dot(x - start, x - start); });
        const V3 along = ends[other].p - start;
        const std::size_t third = most(ends, [&](const V3& x) {
            const V3 across = cross(x - start, along);
            return dot(across, across);
        });
        for (std::size_t i : {one, other, third}) corners_.push_back(ends[i]);
    }

    // The first whose size is the largest, but for rounding.
    template <class Size>
    static std::size_t most(const std::vector<End>& ends, Size size) {
        double largest = 0.0;
        for (const End& end : ends) largest = std::max(largest, size(end.p));
        std::size_t i = 0;
        while (i + 1 < ends.size() && size(ends[i].p) < (1.0 - EVEN) * largest) i++;
        return i;
    }

    static constexpr std::size_t MOST_NEAR = 256;

    const Model& m_;
    Apart pairs_;
    double distance_, gain_, within_, at_once_, later_, shallow_;
    std::vector<Pose> poses_;
    std::vector<char> seen_;       // whether a pair has a row
    std::vector<double> closing_;  // how fast each body moves at most
    std::vector<Near> near_;
    std::vector<std::size_t> close_;
    std::vector<double> heights_;
    std::vector<End> first_, second_, corners_;
};

}  // namespace coopqp
