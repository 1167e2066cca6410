// Frames of joints, one after the other, each as near as limits, bodies and loops let the joints come.
// As a Python class; coopqp.adapters.chunk_filter says what for.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "deciding.hpp"
#include "free_space.hpp"

namespace KERNEL_MODULE {

class Following {
  public:
    // Engines with one task, of least velocity, that are bound: of free arms that keep apart; of
    // arms that hold one object, without asking for distances and with them.
    Following(Engine& apart, Engine& held, Engine& careful, const FreeSpace& space,
              const nb::dict& d)
        : apart_(apart), held_(held), careful_(careful), space_(space.own()),
          lower_(numbers(d, "lower")), upper_(numbers(d, "upper")), step_(numbers(d, "step")),
          hands_(numbers(d, "hands")), shares_(numbers(d, "shares")), look_(number(d, "look")),
          position_(number(d, "position")),
          orientation_(number(d, "orientation")), squeeze_(number(d, "squeeze")), n_(lower_.size()),
          x_(n_), goal_(n_), way_(n_) {}

    // Both hands hold from now on what is between them at q.
    void take_hold(const Numbers& q) {
        held_.kernel().take_hold(q.data());
        careful_.kernel().take_hold(q.data());
    }

    // Frames x, (N, n), all of them numbers, from q on, which becomes the last. Written: where joints
    // are after each, and before it; whether that is not as asked; how far what is asked opens the
    // loop [m], 0 where it does not. recorded: each is asked from the frame before as it is given.
    // rounding: what frames may have of it. Returns how many were done, up to one in which bodies are
    // in each other and no law here has an answer. With the GIL held, which keeps other threads out.
    std::size_t follow(const Numbers& x, const Written& q, const Written& found, const Written& before,
                const Said& changed, const Written& opened, bool holds, bool recorded,
                double rounding) {
        double* now = q.data();
        for (std::size_t k = 0; k < changed.size(); k++) {
            const double* asked = x.data() + k * n_;
            double *to = found.data() + k * n_, loop_offset[6];
            std::copy_n(now, n_, before.data() + k * n_);
            opened.data()[k] = holds ? open(asked, loop_offset) : 0.0;
            const bool fine = opened.data()[k] == 0.0 && reaches(now, asked, rounding) && goes(now, asked);
            changed.data()[k] = !fine;
            std::copy_n(asked, n_, to);
            if (!fine && !recorded && !go_near(now, asked, holds ? loop_offset : nullptr, to)) return k;
            std::copy_n(to, n_, now);
        }
        return changed.size();
    }

  private:
    // How far x opens the loop by more than it may [m], and the squeeze that it asks for, offset.
    double open(const double* x, double* offset) {
        coopqp::Kinematics& seen = held_.kernel().kinematics;
        seen.place(x);
        seen.measure();
        const double* e = seen.loop_error.data();
        const coopqp::V3 along = hand(seen, 0) - hand(seen, 1);
        const double size = std::max(std::sqrt(dot(along, along)), 1e-9);
        const coopqp::V3 u = (1.0 / size) * along;
        const double closer = std::min(std::max(u.x * e[0] + u.y * e[1] + u.z * e[2], 0.0), squeeze_);
        std::fill_n(offset, 6, 0.0);
        offset[0] = closer * u.x;
        offset[1] = closer * u.y;
        offset[2] = closer * u.z;
        const double off = std::hypot(e[0] - offset[0], e[1] - offset[1], e[2] - offset[2]);
        return off > position_ || std::hypot(e[3], e[4], e[5]) > orientation_ ? std::max(off, 1e-9) : 0.0;
    }

    coopqp::V3 hand(const coopqp::Kinematics& seen, std::size_t arm) const {
        const double* p = &hands_[3 * arm];
        const coopqp::Placement at = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {p[0], p[1], p[2]}};
        const auto tip = std::size_t(held_.kernel().model().arms[arm].tip);
        return coopqp::first_three(coopqp::placed(seen.joint(tip), at).p);
    }

    // Whether x is in range, and near enough to q for one frame.
    bool reaches(const double* q, const double* x, double rounding) const {
        for (std::size_t j = 0; j < n_; j++)
            if (!(x[j] >= lower_[j] - rounding && x[j] <= upper_[j] + rounding &&
                  std::fabs(x[j] - q[j]) <= step_[j] + rounding))
                return false;
        return true;
    }

    // Whether bodies keep apart on the way from q to x.
    bool goes(const double* q, const double* x) {
        double far = 0.0;
        for (std::size_t j = 0; j < n_; j++) far = std::max(far, std::fabs(x[j] - q[j]));
        const int count = std::max(1, int(std::ceil(far / look_ - coopqp::ROUNDED)));
        for (int i = count; i > 0; i--)
            if (!space_.free(part(q, x, double(i) / count))) return false;
        return true;
    }

    const double* part(const double* q, const double* x, double share) {
        for (std::size_t j = 0; j < n_; j++) way_[j] = q[j] + share * (x[j] - q[j]);
        return way_.data();
    }

    // Where a frame's step leads from q towards x; loop_offset: of arms that hold. False where bodies are in
    // each other, and no law says how to go on.
    bool go_near(const double* q, const double* x, const double* loop_offset, double* to) {
        for (std::size_t j = 0; j < n_; j++) x_[j] = std::min(std::max(x[j], lower_[j]), upper_[j]);
        // Without asking for distances first, which most frames keep.
        if (loop_offset) {
            held_.toward(q, x_.data(), loop_offset, nullptr, goal_.data());
        } else {
            for (std::size_t j = 0; j < n_; j++)
                goal_[j] = std::min(std::max(x_[j], q[j] - step_[j]), q[j] + step_[j]);
            for (std::size_t j = 0; j < n_; j++)
                goal_[j] = std::min(std::max(goal_[j], lower_[j]), upper_[j]);
        }
        Engine& law = loop_offset ? careful_ : apart_;
        bool told = true, there = goes(q, goal_.data());
        for (const double* about : {(const double*)nullptr, (const double*)goal_.data()}) {
            if (there) break;
            told = law.toward(q, x_.data(), loop_offset, about, goal_.data());
            there = goes(q, goal_.data());
        }
        std::copy(goal_.begin(), goal_.end(), to);
        if (there) return true;
        if (!space_.free(q)) return told;
        for (double share : shares_) {
            std::copy_n(part(q, goal_.data(), share), n_, to);
            if (goes(q, to)) return true;
        }
        std::copy_n(q, n_, to);
        return true;
    }

    Engine &apart_, &held_, &careful_;
    coopqp::FreeSpace space_;
    std::vector<double> lower_, upper_, step_, hands_, shares_;
    double look_, position_, orientation_, squeeze_;
    std::size_t n_;
    std::vector<double> x_, goal_, way_;
};

}  // namespace KERNEL_MODULE
