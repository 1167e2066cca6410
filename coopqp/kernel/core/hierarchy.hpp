// Levels in the null space of the loops, v = v_p + Z z, on one orthonormal basis y = V z.
//
// The rows of a level's tasks are reflected onto the next coordinates of y; what is left of y is
// free for the levels after. In these coordinates a level's cost is that of its own few coordinates
// and, for all others, of damping and joint objectives alone.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "problem.hpp"
#include "reflections.hpp"
#include "shared.hpp"

namespace coopqp {

constexpr double NOTHING = 1e-13;    // left of a task row that others explain
constexpr double ORTHOGONAL = 1e-13;  // cosine of rows whose lengths are singular values
constexpr double HARDLY = 1e-7;  // cosines and turns that leave rows as orthogonal as this squared
constexpr int MOST_SWEEPS = 30;

class Hierarchy {
  public:
    Hierarchy(int free, int most_rows, Arena& arena)
        : free_(free), blocks_(blocks_of(std::max(free, 1))), width_(blocks_ * LANES),
          V_(arena.take(std::size_t(width_) * std::size_t(width_))),
          Y_(arena.take(std::size_t(most_rows + free + LANES) * std::size_t(width_))),
          H_(arena.take(std::size_t(free) * std::size_t(width_))),
          S_(arena.take(std::size_t(most_rows + LANES) * std::size_t(width_))),
          h_(arena.take(std::size_t(width_))), t_(arena.take(std::size_t(width_))),
          sigma_(std::size_t(most_rows + 1)), sizes2_(std::size_t(most_rows + 1)),
          held_pull_(std::size_t(free)),
          column_(std::size_t(most_rows + LANES)) {
        pivots_.reserve(std::size_t(most_rows));  // a tick takes no memory
        left_out_.reserve(std::size_t(most_rows));
    }

    int decided = 0;  // coordinates of y
    int rows = 0;     // of all levels so far
    int held = 0;     // directions that are decided in part

    int blocks() const { return blocks_; }
    int width() const { return width_; }
    double* row(int s) { return Y_ + s * width_; }
    const double* V(int y) const { return V_ + y * width_; }
    int pivot_row(int coordinate) const { return pivots_[std::size_t(coordinate)]; }

    // Take up all rows again that were left out.
    void forget() {
        left_out_.clear();
        held = 0;
    }

    // Hold directions of which rows see next to nothing, as coopqp.qp_law.priorities: each is a row
    // of the next level's cost. After singular_values.
    void hold_noise() {
        for (int s = 0; s < decided; s++) {
            const double size = sigma_[std::size_t(s)];
            if (!(size > IDLE && size <= NOISE)) continue;
            const double part = std::pow((size - IDLE) / (NOISE - IDLE), 6);
            const double root = std::sqrt(MOST_DAMPING * part / std::max(1.0 - part, WALL));
            clear(t_, blocks_);
            add(t_, direction(s), root / size, blocks_of(decided));
            to_z(t_, H_ + held * width_);
            held_pull_[std::size_t(held++)] = root / size;
        }
    }
    // Row of a held direction, in coordinates of z; what it pulls at those decided, per motion.
    const double* held_row(int i) const { return H_ + i * width_; }
    double held_pull(int i) const { return held_pull_[std::size_t(i)]; }

    // From the next begin on, decide nothing by the row that adds least to those before it.
    void leave_out_smallest() {
        int least = 0;
        for (int k = 1; k < decided; k++)
            if (std::fabs(row(pivot_row(k))[k]) < std::fabs(row(pivot_row(least))[least])) least = k;
        left_out_.push_back(pivot_row(least));
    }

    void begin() {
        decided = rows = 0;
        pivots_.clear();
        identity_ = true;
        for (int y = 0; y < free_; y++) unit(V_ + y * width_, y, blocks_);
    }

    // Take up the next `count` rows, which were written to row(rows) ... in coordinates of z; the
    // first `exact` of them must hold.
    void append(int count, int exact) {
        const int soft = rows + exact;
        if (!identity_)
            for (int s = rows; s < rows + count; s++) {
                copy(h_, row(s), blocks_);
                to_y(h_, row(s));
            }
        // Exact rows that outnumber the coordinates depend on each other; one that adds next to nothing
        // must not take the coordinate of another.
        const bool crowded = exact > free_ - decided;
        for (int i = rows; i < rows + count; i++) {
            double beta = 0.0;
            if (decided >= free_) break;
            const int s = crowded && i < soft ? most_left(rows, soft) : i;
            if (std::find(left_out_.begin(), left_out_.end(), s) != left_out_.end()) continue;
            const double least = s < soft ? IDLE : NOTHING;
            const double onto =
                crowded ? reflection(row(s), decided, blocks_, least, h_, beta)
                        : reflect_from(row(s), width_, rows + count - s - 1, decided, blocks_,
                                       least, h_, beta);
            if (onto == 0.0) continue;
            if (crowded) reflect_rows(row(rows), width_, count, h_, beta, blocks_);
            reflect_columns(V_, width_, free_, h_, beta, blocks_, t_);
            put_end(row(s), decided, onto, blocks_);
            pivots_.push_back(s);
            decided++;
            identity_ = false;
        }
        rows += count;
    }

    // y = V z
    void to_y(const double* z, double* y) const { multiply(y, V_, width_, free_, z, blocks_); }

    // z = V' y
    void to_z(const double* y, double* z) const {
        clear(z, blocks_);
        add_rows(z, V_, width_, free_, y, blocks_);
    }

    // Singular values of all rows so far, as many as coordinates are decided, largest nowhere in
    // particular; false where one of them is noise. Afterwards sigma(i) and direction(i) are theirs.
    bool singular_values() {
        bool found = false;
        with(blocks_of(std::max(decided, 1)), [&](auto b) { found = find_singular_values(b); });
        return found;
    }
    double sigma(int s) const { return sigma_[std::size_t(s)]; }
    // Row of length sigma along a right singular vector, in coordinates of y.
    const double* direction(int s) const { return S_ + s * width_; }

  private:
    // Of rows from first to end the one of which those decided before leave most.
    int most_left(int first, int end) const {
        int found = first;
        double most = -1.0;
        for (int s = first; s < end; s++) {
            double left = 0.0;
            for (int y = decided; y < free_; y++) left += Y_[s * width_ + y] * Y_[s * width_ + y];
            const bool is_pivot = std::find(pivots_.begin(), pivots_.end(), s) != pivots_.end();
            const bool is_out = std::find(left_out_.begin(), left_out_.end(), s) != left_out_.end();
            if (is_pivot || is_out || !(left > most)) continue;
            found = s;
            most = left;
        }
        return found;
    }

    // Cosine c and sine s of the angle whose double has the tangent across / apart, by the shorter
    // way; small ones by their series, which is much faster and as exact.
    static void turn(double apart, double across, double& c, double& s) {
        constexpr double SMALL = 1e-3;
        if (std::fabs(across) <= SMALL * std::fabs(apart)) {
            const double twice = across / apart, x2 = twice * twice;
            const double t = 0.5 * twice * (1.0 - 0.25 * x2), t2 = t * t;
            c = 1.0 - 0.5 * t2 * (1.0 - 0.75 * t2);
            s = c * t;
            return;
        }
        const double size = std::fabs(apart), far = std::sqrt(size * size + across * across);
        const double t = (apart >= 0.0 ? across : -across) / (size + far);
        c = std::sqrt((size + far) / (2 * far));
        s = c * t;
    }

    // Turn the copied rows among themselves until only as many are left as there are coordinates,
    // each from its own coordinate on. These are much nearer to orthogonal (Drmac and Veselic 2008).
    void triangulate(int b) {
        std::fill_n(column_.begin() + rows, LANES, 0.0);
        for (int k = 0; k < decided; k++) {
            double rest2 = 0.0;
            for (int s = k; s < rows; s++) {
                column_[std::size_t(s)] = S_[s * width_ + k];
                if (s > k) rest2 += column_[std::size_t(s)] * column_[std::size_t(s)];
            }
            if (rest2 == 0.0) continue;
            double& first = column_[std::size_t(k)];
            const double size = std::sqrt(first * first + rest2), onto = first > 0 ? -size : size;
            first -= onto;
            reflect_columns(S_ + k * width_, width_, rows - k, &first, -1.0 / (onto * first), b, t_);
        }
    }

    // The same, where rows have numbers in the first b blocks alone.
    template <class N>
    bool find_singular_values(N b) {
        for (int s = 0; s < rows; s++) copy(S_ + s * width_, row(s), blocks_);
        for (int s = rows; s < rows + LANES; s++) clear(S_ + s * width_, blocks_);
        if (rows > decided) triangulate(b);
        bool turned = true;
        for (int sweep = 0; sweep < MOST_SWEEPS && turned; sweep++) {
            turned = false;
            for (int i = 0; i < decided; i++)
                sizes2_[std::size_t(i)] = dot(S_ + i * width_, S_ + i * width_, b);
            // Each pair after those before it that have a row in common, as row by row; but neighbours
            // have none, so that none waits for the other.
            for (int ij = 1; ij < 2 * decided - 2; ij++)
                for (int i = std::max(0, ij - decided + 1); 2 * i < ij; i++)
                    turned |= make_orthogonal(i, ij - i, b);
        }
        int found = 0;
        for (int s = 0; s < decided; s++) {
            sigma_[std::size_t(s)] = std::sqrt(dot(S_ + s * width_, S_ + s * width_, b));
            found += sigma_[std::size_t(s)] > NOISE;
        }
        return found == decided;
    }

    // One-sided Jacobi. Returns whether it had more than HARDLY anything to do.
    template <class N>
    bool make_orthogonal(int i, int j, N b) {
        double *x = S_ + i * width_, *y = S_ + j * width_;
        double &xx = sizes2_[std::size_t(i)], &yy = sizes2_[std::size_t(j)];
        const double xy = dot(x, y, b), xy2 = xy * xy, most2 = xx * yy;
        if (!(xy2 > ORTHOGONAL * ORTHOGONAL * most2) || !(xx > 1e-26) || !(yy > 1e-26)) return false;
        double c, s;
        turn(yy - xx, 2.0 * xy, c, s);
        const double more = s / c * xy;
        xx -= more;
        yy += more;
        v4 *p = lanes(x), *q = lanes(y);
        for (int k = 0; k < b; k++) {
            const v4 a = p[k], d = q[k];
            p[k] = a * c - d * s;
            q[k] = a * s + d * c;
        }
        return xy2 > HARDLY * HARDLY * most2 || std::fabs(s) > HARDLY;
    }

    int free_, blocks_, width_;
    double *V_, *Y_, *H_, *S_, *h_, *t_;
    std::vector<double> sigma_, sizes2_, held_pull_, column_;
    std::vector<int> pivots_, left_out_;
    bool identity_ = true;
};

}  // namespace coopqp
