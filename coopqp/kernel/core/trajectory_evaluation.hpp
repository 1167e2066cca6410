// What there was along a motion that has been made: the object, the loops, the errors of tasks.
#pragma once
#include <memory>
#include <vector>

#include "program.hpp"

namespace coopqp {

// A point that is fixed to a joint, or to the world.
struct Fixed {
    int joint;  // -1: the world
    double p[3];
};

// Where it is written, an instant after the other; see coopqp.kernel.trajectory_evaluation.
struct Surveyed {
    double *e, *rate, *moved, *p_WO, *R_WO, *loop_error, *points;
};

class TrajectoryEvaluation {
  public:
    // Tasks are those of one level, of which no row is Python's.
    TrajectoryEvaluation(std::unique_ptr<Arena> arena, std::unique_ptr<Model> model, std::vector<Level> levels,
           std::vector<Primitive> primitives, std::vector<Fixed> points)
        : arena_(std::move(arena)), model_(std::move(model)), kinematics_(*model_),
          levels_(std::move(levels)), points_(std::move(points)) {
        program_.primitives = std::move(primitives);
    }

    std::size_t n() const { return model_->joints.size(); }
    std::size_t rows() const { return levels_[0].e.size(); }
    std::size_t loops() const { return kinematics_.loop_error.size(); }
    std::size_t points() const { return points_.size(); }

    // `moved` is J v of each row that sees the object's twist, where v is given; (instants - 1) of it.
    void look(std::size_t instants, const double* t, const double* q, const double* v,
              const Surveyed& out) {
        const std::size_t n = this->n(), rows = this->rows(), loops = this->loops();
        Level& level = levels_[0];
        for (std::size_t k = 0; k < instants; k++) {
            const double* at = q + k * n;
            kinematics_.place(at);
            kinematics_.measure();
            program_.run(t[k], kinematics_, *model_, at, levels_);
            std::copy(level.e.begin(), level.e.end(), out.e + k * rows);
            std::copy(level.rate.begin(), level.rate.end(), out.rate + k * rows);
            std::copy(kinematics_.p_WO, kinematics_.p_WO + 3, out.p_WO + 3 * k);
            std::copy(kinematics_.R_WO, kinematics_.R_WO + 9, out.R_WO + 9 * k);
            std::copy(kinematics_.loop_error.begin(), kinematics_.loop_error.end(),
                      out.loop_error + k * loops);
            for (std::size_t i = 0; i < points_.size(); i++)
                write(points_[i], out.points + 3 * (k * points_.size() + i));
            if (v && k + 1 < instants) move(v + k * n, out.moved + k * rows);
        }
    }

  private:
    void write(const Fixed& point, double* to) const {
        for (int r = 0; r < 3; r++) to[r] = point.p[r];
        if (point.joint < 0) return;
        const Frame& f = kinematics_.joint(std::size_t(point.joint));
        const v4 p = f.p + f.x * point.p[0] + f.y * point.p[1] + f.z * point.p[2];
        for (int r = 0; r < 3; r++) to[r] = p[r];
    }

    void move(const double* v, double* moved) {
        double twist[6] = {0, 0, 0, 0, 0, 0};
        kinematics_.differentiate();
        for (const Arm& arm : model_->arms) {
            const double* column = arm.columns;
            for (const auto* joints : {&arm.base, &arm.own})
                for (int j : *joints) {
                    for (int r = 0; r < 6; r++) twist[r] += arm.alpha * column[r] * v[j];
                    column += TWIST;
                }
        }
        const Level& level = levels_[0];
        for (std::size_t i = 0; i < level.e.size(); i++) {
            moved[i] = 0.0;
            for (int r = 0; level.twist[i] && r < 6; r++) moved[i] += level.T[8 * i + std::size_t(r)] * twist[r];
        }
    }

    std::unique_ptr<Arena> arena_;
    std::unique_ptr<Model> model_;
    Kinematics kinematics_;
    std::vector<Level> levels_;
    Program program_;
    std::vector<Fixed> points_;
};

}  // namespace coopqp
