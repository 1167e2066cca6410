// A few rows of a task: what they are made of, and what moves their reference.
#pragma once
#include <algorithm>
#include <vector>

#include "rotation.hpp"
#include "shared.hpp"

namespace coopqp {

// As coopqp.model.profile.Profile.
struct Profile {
    using Kind = ProfileKind;
    Kind kind = Kind::Step;
    double duration = 1.0, delay = 0.0;

    void at(double t, double& share, double& speed) const {
        share = 1.0;
        speed = 0.0;
        if (t >= (kind == Kind::Step ? delay : delay + duration)) return;
        const double x = (t - delay) / duration;
        if (x < 0.0) {
            share = 0.0;
        } else if (kind == Kind::Quintic) {
            share = x * x * x * (10.0 + x * (6.0 * x - 15.0));
            speed = 30.0 * x * x * (1.0 - x) * (1.0 - x) / duration;
        } else if (kind == Kind::ConstantVelocity) {
            share = x;
            speed = 1.0 / duration;
        } else {
            trapezoid(x, share, speed);
        }
    }

  private:
    void trapezoid(double x, double& share, double& speed) const {
        const double top = 1.0 / (1.0 - RAMP), left = 1.0 - x;
        if (x < RAMP) {
            share = 0.5 * top * x * x / RAMP;
            speed = top * x / RAMP / duration;
        } else if (x <= 1.0 - RAMP) {
            share = top * (x - 0.5 * RAMP);
            speed = top / duration;
        } else {
            share = 1.0 - 0.5 * top * left * left / RAMP;
            speed = top * left / RAMP / duration;
        }
    }
};

// Where a reference is that follows a signal: arrays that Python fills before each tick.
struct InputValues {
    const double *c = nullptr, *RT = nullptr, *c_dot = nullptr, *omega = nullptr;
};

// As coopqp.model.geometry.Reference.
struct Reference {
    double c_0[3], RT_0[9], c_dot[3], turn[3];
    Profile turning;
    bool turns = false, moves = false;
    double c[3], RT[9], omega[3];
    InputValues followed;

    void begin() {
        std::copy(c_0, c_0 + 3, c);
        std::copy(RT_0, RT_0 + 9, RT);
        std::fill(omega, omega + 3, 0.0);
    }

    void update(double t) {
        if (followed.c) return follow();
        if (!moves) return;
        for (int i = 0; i < 3; i++) c[i] = c_0[i] + c_dot[i] * t;
        if (!turns) return;
        double share, speed, w[3], R[9];
        turning.at(t, share, speed);
        for (int i = 0; i < 3; i++) w[i] = turn[i] * share;
        exp3(w, R);
        product_transposed(RT_0, R, RT);
        for (int i = 0; i < 3; i++) omega[i] = turn[i] * speed;
    }

    void follow() {
        moves = true;
        std::copy(followed.c, followed.c + 3, c);
        std::copy(followed.RT, followed.RT + 9, RT);
        std::copy(followed.c_dot, followed.c_dot + 3, c_dot);
        std::copy(followed.omega, followed.omega + 3, omega);
    }
};

struct Primitive {
    Kind kind;
    int level, at;          // where its rows go
    std::vector<int> rows;  // which of the kind's rows
    Reference reference;
    Profile profile;
    double p_O[3], a_O[3];     // point and axis of the object
    double e_start[3], phi[3]; // error, and turn, at the start
    double length;             // distance; barrier's end; manipulability's scale
    double Q_start[9];
    double velocity[6];
    bool planar;               // radial: in the plane of the first two axes; twist: object's axes
    double weight, gain;       // of joint objectives
    std::vector<double> numbers;  // of joint objectives, by joint; of a relative motion, its loop
};

}  // namespace coopqp
