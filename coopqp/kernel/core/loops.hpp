// The loops eliminated arm by arm, by orthogonal transformations alone.
//
//     J_i v_i - J_0 v_0 = b_i,   i = 1 .. L
//
// Stage i sees arm i's own joints and the carry: what the stages before leave of arm 0's joints and
// of those that move several arms. Reflections split both into what loop i decides and what it
// leaves free. Of the latter only six directions, and one for each joint that moves several arms,
// still move arm 0: they are the next carry, of which later stages only ask what it does to these, its
// touch; the rest is finished, and goes back through the stages to be one of all joints. So each stage
// costs the same however many arms there are, and the finished directions are an orthonormal basis Z
// of the null space of all loops. With two arms this is the factorisation of the 6 x n matrix itself.
#pragma once
#include <memory>
#include <stdexcept>
#include <vector>

#include "kinematics.hpp"
#include "reflections.hpp"
#include "rows.hpp"

namespace coopqp {

constexpr double DEPENDENT = 1e-9;   // of a loop row, what others leave of it [m/rad, 1]
constexpr double UNTOUCHED = 1e-14;  // motion of arm 0 below which a direction does not move it

class Loops {
  public:
    virtual ~Loops() = default;

    int free = 0;          // columns of Z
    double* Z = nullptr;   // (free, lanes)
    double* W = nullptr;   // (free, TWIST), the object's twist along each column of Z

    // Fill W. All arms that hold the object move it alike there, so arm 0 speaks for all.
    void see_object(const Rows& rows) {
        for (int z = 0; z < free; z++)
            rows.twist(0, Z + std::size_t(z) * rows.stride(), W + TWIST * z);
    }

    // Factor at the Jacobians of the model; false where independent rows are not so.
    virtual bool factor() = 0;
    // Motion of least norm with J_loop v = b; b as State.e_loop is ordered.
    virtual void particular(const double* b, double* v) const = 0;
    // y with J_loop' y nearest to -t, added to y; J_loop' y is added to t.
    virtual void balance(double* t, double* y) const = 0;
};

template <int B>
class StagedLoops final : public Loops {
    static constexpr int WIDTH = B * LANES;

    struct Stage {
        int arm, carry, own, next = 0;
        std::vector<int> kept;
        Reflections<B> decide;
        // How the carry moves arm 0, six rows, and the joints that move several arms, (touches, tall).
        double* touch = nullptr;
        int tall = 0;
        // Directions over [carry | own], each from a multiple of four lanes on: first those that
        // change one row alone, then those that rows leave, of these first the next carry.
        double* Q = nullptr;
        double* x = nullptr;    // one direction
        double* rho = nullptr;  // of its rows
        bool compresses = false;

        int rows() const { return int(kept.size()); }
        int left() const { return carry + own - rows(); }
        int own_at() const { return padded(std::max(carry, 1)); }
        double* nulls() const { return Q + rows() * WIDTH; }

        // Lanes of both.
        std::vector<int> coordinates() const {
            std::vector<int> all;
            for (int c = 0; c < carry; c++) all.push_back(c);
            for (int j = 0; j < own; j++) all.push_back(own_at() + j);
            return all;
        }
    };

  public:
    // kept: which of each loop's six rows are independent.
    StagedLoops(const Model& model, const std::vector<std::vector<int>>& kept, Arena& arena)
        : m_(model), shared_(shared_lanes(model)), touches_(6 + int(shared_.size())),
          rows_(arena.take(8 * WIDTH)), h_(arena.take(std::size_t(touches_) * WIDTH)),
          beta_(arena.take(std::size_t(touches_))),
          seen_(arena.take(std::size_t(touches_ + LANES) * WIDTH)),
          idle_(arena.take(std::size_t(WIDTH + LANES) * WIDTH)), scratch_(arena.take(WIDTH)),
          tau_(arena.take(std::size_t(padded(touches_)))),
          moved_(arena.take(std::size_t(padded(touches_)))) {
        int carry = model.base_lanes, tall = LANES * model.base_blocks;
        for (int i = 1; i < model.holding; i++) {
            Stage s;
            s.arm = i;
            s.carry = carry;
            s.own = int(model.arms[std::size_t(i)].own.size());
            s.kept = kept[std::size_t(i - 1)];
            const int left = s.left();
            if (left < 0) throw std::invalid_argument("a loop has fewer joints than rows");
            const bool last = i == model.holding - 1;
            s.compresses = !last && left > padded(touches_);  // no shorter carry is any cheaper
            s.next = last ? 0 : s.compresses ? touches_ : left;
            s.decide.open(arena, s.rows(), s.coordinates());
            s.Q = arena.take(std::size_t(s.rows() + left + LANES) * WIDTH);
            s.x = arena.take(WIDTH);
            s.rho = arena.take(8);
            s.tall = tall;
            s.touch = arena.take(std::size_t(touches_ + LANES) * std::size_t(tall));
            for (std::size_t k = 0; i == 1 && k < shared_.size(); k++)
                s.touch[(6 + k) * std::size_t(tall) + std::size_t(shared_[k])] = 1.0;
            carry = s.next;
            tall = padded(std::max(left, 1));
            free += left - s.next;
            stages_.push_back(std::move(s));
        }
        if (model.holding < 2)
            for (int l = 0; l < model.base_lanes; l++) alone_.push_back(l);
        for (int l : model.loose_lanes) alone_.push_back(l);
        Z = arena.take(std::size_t(padded(free + int(alone_.size()))) * lanes_of(model));
        const int stride = lanes_of(model);
        for (std::size_t i = 0; i < alone_.size(); i++)
            Z[(std::size_t(free) + i) * std::size_t(stride) + std::size_t(alone_[i])] = 1.0;
        free += int(alone_.size());
        W = arena.take(TWIST * std::size_t(padded(free)));
    }

    // Lanes that a chain's widest stage takes; more than WIDTH cannot be done.
    static int width(const Model& model) {
        const int carry = std::max(model.base_lanes, 6 + int(shared_lanes(model).size()));
        int most = 0;
        for (int i = 1; i < model.holding; i++)
            most = std::max(most, padded(std::max(carry, 1)) +
                                      padded(int(model.arms[std::size_t(i)].own.size())));
        return most;
    }

    bool factor() override {
        double* finished = Z;
        for (std::size_t i = 0; i < stages_.size(); i++) {
            Stage& s = stages_[i];
            fill_rows(s);
            if (!s.decide.factor(rows_, DEPENDENT)) return false;
            s.decide.basis(s.Q);
            s.decide.part(s.Q, rows_);
            if (!is_last(i)) carry_on(s, stages_[i + 1]);
            for (int k = s.next; k < s.left(); k++, finished += stride())
                direction(i, s.nulls() + k * WIDTH, finished);
        }
        return true;
    }

    void particular(const double* b, double* v) const override {
        clear(v, m_.blocks);
        if (stages_.empty()) return;
        clear(tau_, blocks_of(touches_));
        for (std::size_t i = 0; i < stages_.size(); i++) {
            const Stage& s = stages_[i];
            alignas(64) double y[8] = {};
            for (int k = 0; k < s.rows(); k++)
                y[k] = b[k] - of_touches(s, s.kept[std::size_t(k)], tau_);
            clear(s.x, B);
            add_rows(s.x, s.Q, WIDTH, s.rows(), y, Blocks<B>{});
            b += s.rows();
            if (is_last(i)) break;
            multiply(moved_, s.touch, s.tall, touches_, s.x, s.own_at() / LANES);
            add(tau_, moved_, 1.0, blocks_of(touches_));
        }
        for (std::size_t i = stages_.size(); i-- > 0;) {
            const Stage& s = stages_[i];
            if (!is_last(i)) add_rows(s.x, s.nulls(), WIDTH, s.next, stages_[i + 1].x, Blocks<B>{});
            const Arm& arm = m_.arms[std::size_t(s.arm)];
            copy(v + arm.first, s.x + s.own_at(), arm.own_blocks);
        }
        copy(v, stages_[0].x, m_.base_blocks);
    }

    void balance(double* t, double* y) const override {
        if (stages_.empty()) return;
        copy(stages_[0].x, t, m_.base_blocks);
        int at = 0;
        for (std::size_t i = 0; i < stages_.size(); i++) {
            const Stage& s = stages_[i];
            const Arm& arm = m_.arms[std::size_t(s.arm)];
            copy(s.x + s.own_at(), t + arm.first, arm.own_blocks);
            clear(s.x + s.own_at() + LANES * arm.own_blocks, rest(s));
            multiply(s.rho, s.Q, WIDTH, s.rows(), s.x, Blocks<B>{});
            at += s.rows();
            if (is_last(i)) break;
            clear(stages_[i + 1].x, stages_[i + 1].own_at() / LANES);
            multiply(stages_[i + 1].x, s.nulls(), WIDTH, s.next, s.x, Blocks<B>{});
        }
        clear(tau_, blocks_of(touches_));  // what loops push at arm 0, and at shared joints
        for (std::size_t i = stages_.size(); i-- > 0;) {
            const Stage& s = stages_[i];
            at -= s.rows();
            if (!is_last(i)) {
                alignas(64) double more[8];
                const int blocks = s.own_at() / LANES;
                clear(s.x, blocks);
                add_rows(s.x, s.touch, s.tall, touches_, tau_, blocks);
                multiply(more, s.Q, WIDTH, s.rows(), s.x, blocks);
                add(s.rho, more, 1.0, blocks_of(s.rows()));
            }
            const Arm& arm = m_.arms[std::size_t(s.arm)];
            double by[6] = {};
            for (int k = 0; k < s.rows(); k++) {
                const int r = s.kept[std::size_t(k)];
                y[at + k] -= s.rho[k];
                by[r] = -s.rho[k];
                tau_[r] += s.rho[k];
                for (std::size_t j = 0; j < shared_.size(); j++)
                    tau_[6 + j] -= m_.J_base(s.arm, r)[shared_[j]] * s.rho[k];
            }
            if (arm.own_blocks) add_six(t + arm.first, m_.J_own(s.arm, 0), by, arm.own_blocks);
        }
        add_six(t, m_.J_base(0, 0), tau_, m_.base_blocks);
        for (std::size_t j = 0; j < shared_.size(); j++) t[shared_[j]] += tau_[6 + j];
    }

  private:
    // Of joints in block 0 that move another arm than the first.
    static std::vector<int> shared_lanes(const Model& model) {
        std::vector<int> shared;
        for (std::size_t i = 1; i < model.arms.size(); i++)
            for (int j : model.arms[i].base) {
                const int lane = model.joints[std::size_t(j)].lane;
                if (std::find(shared.begin(), shared.end(), lane) == shared.end())
                    shared.push_back(lane);
            }
        return shared;
    }
    static std::size_t lanes_of(const Model& model) { return std::size_t(model.blocks) * LANES; }
    int stride() const { return m_.blocks * LANES; }
    bool is_last(std::size_t stage) const { return stage + 1 == stages_.size(); }

    // Blocks of a direction over [carry | own] after both.
    int rest(const Stage& s) const {
        return B - s.own_at() / LANES - m_.arms[std::size_t(s.arm)].own_blocks;
    }

    // What a row of a loop sees of a motion of arm 0 and of shared joints, as touches are ordered.
    double of_touches(const Stage& s, int r, const double* touches) const {
        double seen = -touches[r];
        for (std::size_t k = 0; k < shared_.size(); k++)
            seen += m_.J_base(s.arm, r)[shared_[k]] * touches[6 + k];
        return seen;
    }

    // Rows of one loop over [carry | own].
    void fill_rows(Stage& s) {
        const Arm& arm = m_.arms[std::size_t(s.arm)];
        const int of_carry = s.own_at() / LANES, own_at = s.own_at(), own = arm.own_blocks;
        const bool first = &s == &stages_[0];
        if (first && !is_last(0)) copy(s.touch, m_.J_base(0, 0), 6 * m_.base_blocks);
        double* row = rows_;
        for (int r : s.kept) {
            const double *touch = s.touch + r * s.tall, *J_0 = first ? m_.J_base(0, r) : touch;
            for (int b = 0; b < of_carry; b++) lanes(row)[b] = -lanes(J_0)[b];
            if (!arm.base.empty()) {
                const double* J = m_.J_base(s.arm, r);
                if (first) add(row, J, 1.0, of_carry);
                for (std::size_t k = 0; !first && k < shared_.size(); k++)
                    add(row, s.touch + (6 + int(k)) * s.tall, J[shared_[k]], of_carry);
            }
            copy(row + own_at, m_.J_own(s.arm, r), own);
            clear(row + own_at + own * LANES, rest(s));
            row += WIDTH;
        }
    }

    // What the directions that rows leave do to arm 0 and shared joints, turned so that the last of
    // them do nothing.
    void carry_on(const Stage& s, const Stage& next) {
        const int left = s.left(), tall = next.tall, blocks = tall / LANES;
        for (int r = 0; r < touches_; r++)
            multiply(next.touch + r * tall, s.nulls(), WIDTH, left, s.touch + r * s.tall,
                     s.own_at() / LANES);
        if (!s.compresses) return;
        for (int k = 0; k < left - s.next; k++) unit(idle_ + k * WIDTH, s.next + k, blocks);
        find_idle(next.touch, tall, left - s.next);
        for (int k = left; k-- > s.next;) {
            copy(h_, idle_ + (k - s.next) * WIDTH, blocks);
            const double size = std::sqrt(dot(h_, h_, blocks)), onto = h_[k] > 0 ? -size : size;
            h_[k] -= onto;
            const double beta = -1.0 / (onto * h_[k]);
            reflect_rows(idle_, WIDTH, k - s.next, h_, beta, blocks);
            reflect_rows(next.touch, tall, touches_, h_, beta, blocks);
            reflect_columns(s.nulls(), WIDTH, left, h_, beta, B, scratch_);
        }
        for (int r = 0; r < touches_; r++) {
            double* row = next.touch + r * tall;
            put_end(row, s.next - 1, row[s.next - 1], blocks);
        }
    }

    // Turn unit vectors along the last lanes into directions that no row of a touch sees.
    void find_idle(const double* touch, int tall, int count) {
        const int blocks = tall / LANES;
        copy(seen_, touch, touches_ * blocks);
        int rank = 0;
        for (int r = 0; r < touches_; r++) {
            double *row = seen_ + r * tall, *h = h_ + rank * WIDTH;
            const double onto =
                reflect_from(row, tall, touches_ - r - 1, rank, blocks, UNTOUCHED, h, beta_[rank]);
            rank += onto != 0.0;
        }
        while (rank-- > 0)
            reflect_rows(idle_, WIDTH, count, h_ + rank * WIDTH, beta_[rank], blocks);
    }

    // A direction over [carry | own] of a stage as one of all joints; those of arms after it are at rest.
    void direction(std::size_t stage, const double* x, double* v) const {
        for (std::size_t i = stage;; i--) {
            const Stage& s = stages_[i];
            const Arm& arm = m_.arms[std::size_t(s.arm)];
            copy(v + arm.first, x + s.own_at(), arm.own_blocks);
            if (i == 0) break;
            const Stage& before = stages_[i - 1];
            double* whole = before.x;
            clear(whole, B);
            add_rows(whole, before.nulls(), WIDTH, before.next, x, Blocks<B>{});
            x = whole;
        }
        copy(v, x, m_.base_blocks);
    }

    const Model& m_;
    std::vector<Stage> stages_;
    std::vector<int> shared_, alone_;
    int touches_;  // of arm 0 and of shared joints
    double *rows_, *h_, *beta_, *seen_, *idle_, *scratch_, *tau_, *moved_;
};

// Of the width that a chain needs.
inline std::unique_ptr<Loops> make_loops(const Model& m, const std::vector<std::vector<int>>& kept,
                                         Arena& arena) {
    const int blocks = blocks_of(StagedLoops<2>::width(m));
    if (blocks > 17) throw std::invalid_argument("two arms have too many joints");
    if (blocks <= 2) return std::make_unique<StagedLoops<2>>(m, kept, arena);
    if (blocks == 3) return std::make_unique<StagedLoops<3>>(m, kept, arena);
    if (blocks == 4) return std::make_unique<StagedLoops<4>>(m, kept, arena);
    if (blocks <= 6) return std::make_unique<StagedLoops<6>>(m, kept, arena);
    return std::make_unique<StagedLoops<17>>(m, kept, arena);
}

}  // namespace coopqp
