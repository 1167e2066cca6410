// Motions along the loops that leave them closed, without tasks or limits.
#pragma once
#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "kinematics.hpp"
#include "loops.hpp"

namespace coopqp {

class Slide {
  public:
    Slide(std::unique_ptr<Arena> arena, std::unique_ptr<Model> model,
          std::vector<std::vector<int>> kept)
        : arena_(std::move(arena)),
          m_(std::move(model)),
          kept_(std::move(kept)),
          kinematics_(*m_),
          loops_(make_loops(*m_, kept_, *arena_)),
          b_(std::size_t(6 * std::max(m_->loops(), 1))),
          way_(arena_->take(std::size_t(m_->blocks) * LANES)),
          v_(arena_->take(std::size_t(m_->blocks) * LANES)) {}

    int n() const { return m_->n(); }

    // Go by `size` along what the loops leave of a direction, over the joints, then close the loops
    // by Newton steps of least norm. Returns the largest gap of a loop in place or angle; below zero
    // where rows that are independent in general are not so here, and q is where they were so last.
    double step(double* q, const double* direction, double size, int newton) {
        if (!look(q)) return -1.0;
        clear(v_, m_->blocks);
        clear(way_, m_->blocks);
        for (int j = 0; j < n(); j++) v_[m_->joints[std::size_t(j)].lane] = direction[j];
        for (int z = 0; z < loops_->free; z++) {
            const double* along = loops_->Z + std::size_t(z * m_->blocks * LANES);
            add(way_, along, dot(along, v_, m_->blocks), m_->blocks);
        }
        const double length = std::sqrt(dot(way_, way_, m_->blocks));
        move(q, way_, size / std::max(length, LEAST));
        for (int i = 0; i < newton; i++) {
            if (!look(q)) return -1.0;
            std::size_t at = 0;
            for (std::size_t l = 0; l < kept_.size(); l++)
                for (int r : kept_[l]) b_[at++] = kinematics_.loop_error[6 * l + std::size_t(r)];
            loops_->particular(b_.data(), v_);
            move(q, v_, -1.0);
        }
        kinematics_.place(q);
        kinematics_.measure();
        double gap = 0.0;
        for (std::size_t i = 0; i < 6 * kept_.size(); i += 3)
            gap = std::max(gap, std::sqrt(dot3(&kinematics_.loop_error[i], &kinematics_.loop_error[i])));
        return gap;
    }

  private:
    static constexpr double LEAST = 1e-9;  // of a direction that the loops leave

    bool look(const double* q) {
        kinematics_.place(q);
        kinematics_.measure();
        kinematics_.differentiate();
        return loops_->factor();
    }

    void move(double* q, const double* v, double by) const {
        for (int j = 0; j < n(); j++) q[j] += by * v[m_->joints[std::size_t(j)].lane];
    }

    std::unique_ptr<Arena> arena_;
    std::unique_ptr<Model> m_;
    std::vector<std::vector<int>> kept_;
    Kinematics kinematics_;
    std::unique_ptr<Loops> loops_;
    std::vector<double> b_;
    double *way_, *v_;
};

}  // namespace coopqp
