// The loop-closure offset, followed at measured joints, as coopqp.model.loop_observer explains it.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "kinematics.hpp"
#include "shared.hpp"

namespace coopqp {

// What does not change, and arrays that Python owns, as LoopObserver and State have them.
struct Observed {
    std::vector<double> up, at_origin;  // (3,), (6 N, 3)
    double dt, share, most[2];
    int every;   // ticks between two looks at the sag
    bool known;  // the stiffness of the servos
    const double* compliance;  // (n, n)
    double *sag, *torque, *opened, *told;  // told: load, doubt, ticks
    double *left, *stalled, *spent, span;  // as LoopObserver._look_back and _learns have them
    std::vector<double> band;  // by which each joint may stay on either side of its command, (n,)
};

class LoopObserver {
  public:
    LoopObserver(const Model& model, Observed given)
        : model_(model), o_(std::move(given)), measured_(model), q_(model.joints.size()), reading_(q_.size()),
          before_(6 * model.arms.size()), opened_(before_.size()), left_(3 * before_.size()),
          stalled_(4 * model.arms.size()),
          late_(*std::max_element(o_.band.begin(), o_.band.end()) > 0.0) {}

    // Learn from joints measured at `reading` where q is commanded and v was. Its Jacobians are up to
    // date; the loop offset and the observer's state are moved. False where that is Python's: nothing
    // is moved then.
    bool update(const Kinematics& there, const double* q, const double* v, const double* reading,
                double* loop_offset, double* observer_state) {
        const std::size_t loops = 6 * (model_.arms.size() - 1);
        if (std::isnan(observer_state[0])) return false;
        std::copy_n(o_.told, 3, told_);
        std::copy_n(observer_state, 2, state_);
        std::copy_n(loop_offset, loops, before_.begin());
        std::copy_n(o_.opened, loops, opened_.begin());
        std::copy_n(o_.left, 3 * loops, left_.begin());
        std::copy_n(o_.stalled, 2 * loops / 3, stalled_.begin());
        spent_ = *o_.spent;
        const bool began = o_.told[2] == 0.0;
        const bool rests = at_rest(v);
        const double load = unload(there, q, rests, reading, observer_state);
        measured_.place(q_.data());
        measured_.measure();
        loop_offset_ = loop_offset;
        observer_state_ = observer_state;
        moved_ = true;
        const std::size_t closed = 6 * std::size_t(std::max(model_.loops(), 0));
        look_back(there, rests);
        for (std::size_t i = 0; i < loops; i += 3) {
            const double share = learns(there, i, observer_state[1]) * (o_.stalled[i / 3] < SPANS);
            for (std::size_t r = i; i < closed && r < i + 3; r++)
                loop_offset[r] += share * (measured_.loop_error[r] - there.loop_error[r]) +
                          (began ? 0.0 : load * opened_[r] - load * o_.opened[r]);
        }
        for (std::size_t i = 0; i < closed; i += 3) {
            double away[3];
            for (std::size_t r = 0; r < 3; r++)
                away[r] = loop_offset[i + r] - (observer_state[2 + i + r] - load * o_.opened[i + r]);
            if (!(std::sqrt(dot3(away, away)) < o_.most[i / 3 % 2])) {
                forget();
                return false;
            }
        }
        return true;
    }

    // What has been learnt so far is not forgotten.
    void begin() { moved_ = false; }

    // Have again what was before an update since then.
    void forget() {
        if (!moved_) return;
        moved_ = false;
        std::copy_n(told_, 3, o_.told);
        std::copy_n(state_, 2, observer_state_);
        std::copy_n(before_.begin(), 6 * (model_.arms.size() - 1), loop_offset_);
        std::copy_n(opened_.begin(), 6 * (model_.arms.size() - 1), o_.opened);
        std::copy_n(left_.begin(), 18 * (model_.arms.size() - 1), o_.left);
        std::copy_n(stalled_.begin(), 4 * (model_.arms.size() - 1), o_.stalled);
        *o_.spent = spent_;
    }

  private:
    // The reading without dead band and sag, q_; the load that it is taken to have.
    double unload(const Kinematics& there, const double* q, bool rests, const double* reading,
                  double* observer_state) {
        const std::size_t n = q_.size();
        if (std::fmod(o_.told[2], double(o_.every)) == 0.0) look_at_sag(there);
        o_.told[2] += 1.0;
        for (std::size_t j = 0; j < n; j++) {
            const double lag = reading[j] - q[j];
            q_[j] = lag - std::min(std::max(lag, -o_.band[j]), o_.band[j]);
            reading_[j] = late_ ? q[j] + q_[j] : reading[j];
        }
        double load = rests ? load_of_sag() : std::numeric_limits<double>::quiet_NaN();
        observer_state[1] = std::isfinite(load) ? observer_state[1] + o_.dt : 0.0;
        if (observer_state[1] > AFTER)
            observer_state[0] += std::min(1.0, o_.dt / FEELS) * (load - observer_state[0]);
        o_.told[0] = o_.known ? observer_state[0] : std::numeric_limits<double>::quiet_NaN();
        load = observer_state[0];
        if (!o_.known && load * largest_sag() < SLIGHT) load = 0.0;
        for (std::size_t j = 0; j < n; j++) q_[j] = reading_[j] - load * o_.sag[j];
        return load;
    }

    // What is left of a loop's error, a rotation as it counts.
    double left(const Kinematics& there, std::size_t i) const {
        return (measured_.loop_error[i] - there.loop_error[i]) * (i % 6 < 3 ? 1.0 : TURN_COUNTS);
    }

    // As LoopObserver._learns, of three values from i on.
    double learns(const Kinematics& there, std::size_t i, double rested) {
        const std::size_t loops = model_.arms.size() - 1;
        double *last = o_.left + 12 * loops, &noise = o_.stalled[2 * loops + i / 3];
        double along = 0.0, apart = 0.0;
        for (std::size_t r = i; r < i + 3; r++) {
            const double now = left(there, r), by = now - last[r];
            along += now * last[r], apart += by * by;
            last[r] = now;
        }
        noise += o_.share * (0.5 * apart - noise);
        const bool happens = along > std::max(HAPPENED * HAPPENED, LOUDER * noise);
        const double faster = happens ? SOONEST : o_.known ? SOONER : 1.0;
        return o_.share * (rested > AFTER ? faster : 1.0);
    }

    // As LoopObserver._look_back, of loop errors as measured and there.
    void look_back(const Kinematics& there, bool rests) {
        const std::size_t loops = model_.arms.size() - 1;
        double *total = o_.left, *before = o_.left + 6 * loops;
        if (!rests) {
            *o_.spent = 0.0;
            std::fill_n(total, 6 * loops, 0.0);
            std::fill_n(before, 6 * loops, std::numeric_limits<double>::quiet_NaN());
            std::fill_n(o_.stalled, 2 * loops, 0.0);
            return;
        }
        for (std::size_t i = 0; i < 6 * loops; i++) total[i] += left(there, i);
        if (++*o_.spent < o_.span) return;
        *o_.spent = 0.0;
        for (std::size_t half = 0; half < 2 * loops; half++) {
            double size = 0.0, along = 0.0, change = 0.0;
            for (std::size_t i = 3 * half; i < 3 * half + 3; i++) {
                const double mean = total[i] / o_.span, was = before[i], by = mean - was;
                size += was * was, along += by * was, change += by * by;
                before[i] = mean, total[i] = 0.0;
            }
            double& spans = o_.stalled[half];
            const bool stalls = spans < SPANS ? std::fabs(along) < STALLED * size
                                              : change < HAPPENED * HAPPENED;
            spans = stalls ? spans + 1.0 : 0.0;
        }
    }

    double largest_sag() const {
        double most = 0.0;
        for (std::size_t j = 0; j < q_.size(); j++) most = std::max(most, std::fabs(o_.sag[j]));
        return most;
    }

    // As WeightSag.update.
    void look_at_sag(const Kinematics& there) {
        double load[3], h[6];
        std::fill_n(o_.torque, q_.size(), 0.0);
        transposed_times3(there.R_WO, o_.up.data(), load);
        for (int i = 0; i < model_.holding; i++) {
            const double* G = &o_.at_origin[std::size_t(18 * i)];
            for (int half = 0; half < 2; half++) {
                double own[3];
                times3(G + 9 * half, load, own);
                times3(there.R_WO, own, h + 3 * half);
            }
            each_column(model_.arms[std::size_t(i)], [&](int j, const double* column) {
                for (int r = 0; r < 6; r++) o_.torque[j] += column[r] * h[r];
            });
        }
        for (std::size_t j = 0; j < q_.size(); j++) {
            const double* row = o_.compliance + j * q_.size();
            o_.sag[j] = 0.0;
            for (std::size_t k = 0; k < q_.size(); k++) o_.sag[j] -= row[k] * o_.torque[k];
        }
        double first[6], other[6];
        twist(0, o_.sag, first);
        for (std::size_t i = 1; i < model_.arms.size(); i++) {
            twist(i, o_.sag, other);
            for (std::size_t r = 0; r < 6; r++) o_.opened[6 * (i - 1) + r] = other[r] - first[r];
        }
        o_.told[1] = DOUBT / std::max(largest_sag(), SAG_ROUNDING);
    }

    // As WeightSag.load, of the sag q_.
    double load_of_sag() const {
        const double unknown = std::numeric_limits<double>::quiet_NaN();
        double size = 0.0, along = 0.0, most = 0.0, all = 0.0, other = 0.0;
        for (std::size_t j = 0; j < q_.size(); j++) {
            size -= o_.torque[j] * o_.sag[j];
            along -= o_.torque[j] * q_[j];
            most = std::max(most, std::fabs(q_[j]));
        }
        if (!(size > SAG_ROUNDING)) return unknown;
        const double load = std::max(0.0, along / size);
        for (std::size_t j = 0; j < q_.size(); j++) {
            const double r = q_[j] - load * o_.sag[j];
            all += q_[j] * q_[j];
            other += r * r;
        }
        return most > FARTHEST && other > (1.0 - SHAPED) * all ? unknown : load;
    }

    // As _rests, of commanded joints that moved at v.
    bool at_rest(const double* v) const {
        double v2 = 0.0, V2 = 0.0, V[6] = {}, own[6];
        for (std::size_t j = 0; j < q_.size(); j++) v2 += v[j] * v[j];
        if (v2 > MOVES * MOVES) return false;
        for (std::size_t i = 0; i < model_.arms.size(); i++) {
            twist(i, v, own);
            for (int r = 0; r < 6; r++) V[r] += model_.arms[i].alpha * own[r];
        }
        for (int r = 0; r < 6; r++) {
            const double x = V[r] * (r < 3 ? 1.0 : TURN_COUNTS);
            V2 += x * x;
        }
        return V2 < REST * REST;
    }

    // J_i x, (v; omega) of the object as carried by an arm.
    void twist(std::size_t arm, const double* x, double* V) const {
        std::fill_n(V, 6, 0.0);
        each_column(model_.arms[arm], [&](int j, const double* column) {
            for (int r = 0; r < 6; r++) V[r] += column[r] * x[j];
        });
    }

    template <class Use>
    static void each_column(const Arm& arm, const Use& use) {
        const double* column = arm.columns;
        for (const auto* joints : {&arm.base, &arm.own})
            for (int j : *joints) {
                use(j, column);
                column += TWIST;
            }
    }

    const Model& model_;
    Observed o_;
    Kinematics measured_;
    std::vector<double> q_, reading_, before_, opened_, left_, stalled_;
    const bool late_;  // whether a joint has a dead band
    double told_[3], state_[2], spent_ = 0.0;
    double *loop_offset_ = nullptr, *observer_state_ = nullptr;
    bool moved_ = false;
};

}  // namespace coopqp
