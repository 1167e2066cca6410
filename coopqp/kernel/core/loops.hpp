// The loops eliminated arm by arm, by orthogonal transformations alone.
//
//     J_i v_i - J_0 v_0 = b_i,   i = 1 .. L
//
// Stage i sees arm i's own joints and the carry: what the stages before leave of arm 0's joints and
// of those that move several arms. Reflections split both into what loop i decides and what it
// leaves free. Of the latter only six directions, and one for each joint that moves several arms,
// still move arm 0: they are the next carry, the rest is finished. So each stage costs the same
// however many arms there are, and the finished directions are an orthonormal basis Z of the null
// space of all loops. With two arms this is the factorisation of the 6 x n matrix itself.
#pragma once
#include <memory>
#include <stdexcept>
#include <vector>

#include "kinematics.hpp"
#include "reflections.hpp"

namespace coopqp {

constexpr double DEPENDENT = 1e-9;   // of a loop row, what others leave of it [m/rad, 1]
constexpr double UNTOUCHED = 1e-14;  // motion of arm 0 below which a direction does not move it

class Loops {
  public:
    virtual ~Loops() = default;

    int free = 0;          // columns of Z
    double* Z = nullptr;   // (free, lanes)

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
        Reflections<B> decide, compress;
        double* E;  // the carry's directions, (carry, lanes); of the first stage none
        // Directions over [carry | own], each from a multiple of four lanes on: first those that
        // change one row alone, then those that rows leave, of these first the next carry.
        double* Q;
        bool compresses = false;

        int rows() const { return int(kept.size()); }
        int left() const { return carry + own - rows(); }
        int own_at() const { return padded(std::max(carry, 1)); }

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
        : m_(model), rows_(arena.take(8 * WIDTH)),
          touch_(arena.take((6 + MOST_SHARED) * WIDTH)) {
        shared_ = shared_lanes(model);
        const int touches = 6 + int(shared_.size());
        int carry = model.base_lanes;
        for (int i = 1; i < model.holding; i++) {
            const int own = int(model.arms[std::size_t(i)].own.size());
            Stage s{i, carry, own, 0, kept[std::size_t(i - 1)], {}, {}, nullptr, nullptr, false};
            const int left = s.left();
            if (left < 0) throw std::invalid_argument("a loop has fewer joints than rows");
            const bool last = i == model.holding - 1;
            s.next = last ? 0 : std::min(left, touches);
            s.compresses = !last && left > touches;
            s.decide.open(arena, s.rows(), s.coordinates());
            std::vector<int> first(std::size_t(left), 0);
            for (int k = 0; k < left; k++) first[std::size_t(k)] = k;
            if (s.compresses) s.compress.open(arena, touches, first);
            s.Q = arena.take(std::size_t(s.rows() + left + LANES) * WIDTH);
            if (i > 1) s.E = arena.take(std::size_t(s.own_at()) * lanes_of(model));
            carry = s.next;
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
            if (!s.decide.factor(rows_, s.rows(), DEPENDENT, true)) return false;
            const int left = s.left();
            double* nulls = s.Q + s.rows() * WIDTH;
            s.decide.basis(s.Q);
            s.decide.part(s.Q);
            if (s.compresses) compress(s, left, nulls);
            for (int k = 0; k < left; k++) {
                const bool carried = k < s.next;
                double* to = carried ? stages_[i + 1].E + k * stride() : finished;
                direction(s, nulls + k * WIDTH, to);
                if (!carried) finished += stride();
            }
        }
        return true;
    }

    void particular(const double* b, double* v) const override {
        clear(v, m_.blocks);
        alignas(64) double x[WIDTH];
        for (const Stage& s : stages_) {
            double y[8] = {};
            for (int k = 0; k < s.rows(); k++) {
                y[k] = b[k];
                if (s.E) y[k] -= along_base(s, s.kept[std::size_t(k)], v);  // else v is zero
            }
            clear(x, B);
            add_rows(x, s.Q, WIDTH, s.rows(), y, Blocks<B>{});
            add_direction(s, x, v);
            b += s.rows();
        }
    }

    void balance(double* t, double* y) const override {
        if (stages_.empty()) return;
        alignas(64) double x[WIDTH], g[MOST_BASE], rho[MOST_STAGES][8];
        const int base = m_.base_blocks;
        int at = 0;
        copy(g, t, base);
        for (std::size_t i = 0; i < stages_.size(); i++) {
            const Stage& s = stages_[i];
            gather(s, g, t, x);
            multiply(rho[i], s.Q, WIDTH, s.rows(), x, Blocks<B>{});
            multiply(g, s.Q + s.rows() * WIDTH, WIDTH, s.next, x, Blocks<B>{});
            at += s.rows();
        }
        alignas(64) double w[MOST_BASE] = {};
        for (std::size_t i = stages_.size(); i-- > 0;) {
            const Stage& s = stages_[i];
            at -= s.rows();
            if (i + 1 < stages_.size()) {
                alignas(64) double more[8];
                clear(x, B);
                if (s.E)
                    multiply(x, s.E, stride(), s.own_at(), w, base);
                else
                    copy(x, w, base);
                multiply(more, s.Q, WIDTH, s.rows(), x, Blocks<B>{});
                for (int k = 0; k < s.rows(); k++) rho[i][k] += more[k];
            }
            const Arm& arm = m_.arms[std::size_t(s.arm)];
            double by[6] = {}, back[6] = {};
            for (int k = 0; k < s.rows(); k++) {
                const int r = s.kept[std::size_t(k)];
                y[at + k] -= rho[i][k];
                by[r] = -rho[i][k];
                back[r] = rho[i][k];
            }
            if (!arm.base.empty()) add_six(w, m_.J_base(s.arm, 0), by, base);
            add_six(w, m_.J_base(0, 0), back, base);
            if (arm.own_blocks) add_six(t + arm.first, m_.J_own(s.arm, 0), by, arm.own_blocks);
        }
        add(t, w, 1.0, base);
    }

  private:
    static constexpr int MOST_SHARED = 6, MOST_STAGES = 16, MOST_BASE = WIDTH;
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

    // Rows of one loop over [carry | own].
    void fill_rows(const Stage& s) {
        const int base = m_.base_blocks;
        const Arm& arm = m_.arms[std::size_t(s.arm)];
        alignas(64) double moved[MOST_BASE];
        const int own_at = s.own_at(), own = arm.own_blocks, rest = B - own_at / LANES - own;
        double* row = rows_;
        for (int r : s.kept) {
            const v4 *Ji = lanes(m_.J_base(s.arm, r)), *J0 = lanes(m_.J_base(0, r));
            v4* to = lanes(s.E ? moved : row);
            for (int b = 0; b < base; b++) to[b] = Ji[b] - J0[b];
            if (s.E) multiply(row, s.E, stride(), own_at, moved, base);
            if (own) copy(row + own_at, m_.J_own(s.arm, r), own);
            clear(row + own_at + own * LANES, rest);
            row += WIDTH;
        }
    }

    // Turn the directions left so that the first of them alone move arm 0 and shared joints.
    void compress(Stage& s, int left, double* nulls) {
        const int base = m_.base_blocks, touches = 6 + int(shared_.size());
        alignas(64) double moved[MOST_BASE];
        for (int k = 0; k < touches; k++) clear(touch_ + k * WIDTH, B);
        for (int i = 0; i < left; i++) {
            clear(moved, base);
            const double* null = nulls + i * WIDTH;
            if (s.E)
                add_rows(moved, s.E, stride(), s.carry, null, base);
            else
                copy(moved, null, base);
            for (int r = 0; r < 6; r++) touch_[r * WIDTH + i] = dot(m_.J_base(0, r), moved, base);
            for (std::size_t k = 0; k < shared_.size(); k++)
                touch_[(6 + int(k)) * WIDTH + i] = moved[shared_[k]];
        }
        s.compress.factor(touch_, touches, UNTOUCHED, false);
        s.compress.mix(nulls);
    }

    // A direction over [carry | own] as one of all joints.
    void direction(const Stage& s, const double* x, double* v) const {
        clear(v, m_.blocks);
        add_direction(s, x, v);
    }

    void add_direction(const Stage& s, const double* x, double* v) const {
        const Arm& arm = m_.arms[std::size_t(s.arm)];
        if (s.E)
            add_rows(v, s.E, stride(), s.carry, x, arm.first / LANES);
        else
            add(v, x, 1.0, m_.base_blocks);
        add(v + arm.first, x + s.own_at(), 1.0, arm.own_blocks);
    }

    void gather(const Stage& s, const double* carry, const double* t, double* x) const {
        const Arm& arm = m_.arms[std::size_t(s.arm)];
        clear(x, B);
        copy(x, carry, s.own_at() / LANES);
        copy(x + s.own_at(), t + arm.first, arm.own_blocks);
    }

    double along_base(const Stage& s, int r, const double* v) const {
        return dot(m_.J_base(s.arm, r), v, m_.base_blocks) -
               dot(m_.J_base(0, r), v, m_.base_blocks);
    }

    const Model& m_;
    std::vector<Stage> stages_;
    std::vector<int> shared_, alone_;
    double *rows_, *touch_;
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
