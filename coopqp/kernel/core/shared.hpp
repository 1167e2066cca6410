// Made by `python -m tests.kernel.shared` from Python, where the names are explained.
#pragma once

namespace coopqp {

// coopqp.qp_law.equations
constexpr double SCALE_WEIGHT = 1000.0;
constexpr double ALL_OF_IT = 0.999999;
constexpr double LEAST_SPEED = 0.0001;
constexpr double MOST_DAMPING = 10000.0;
constexpr double GROWS = 1.5;
constexpr double MOST_GROWN = 16.0;
constexpr double FADES_IN = 0.2;
constexpr double FADES_AFTER = 0.3;
constexpr double SWINGS_AT = 0.0002;
constexpr double REVERSALS = 4.0;
constexpr double FORGETS = 0.985;
constexpr double NO_REVERSAL = 1e-300;
constexpr double BENDS = 2.0;
constexpr double LETS_GO = 0.97;
constexpr double FIRM = 100.0;

// coopqp.qp_law.nearest
constexpr double WHOLE = 0.5;
constexpr double LITTLE = 0.1;
constexpr double SLOW = 0.005;
constexpr double FAST = 1.0;
constexpr double LESS = 0.001;
constexpr double MET = 1e-06;
constexpr double NEAR = 0.1;
constexpr double ASIDE = 1000.0;

// coopqp.qp_law.level
constexpr double DECIDED = 1e-07;
constexpr double UNSEEN = 3e-08;

// coopqp.qp_law.priorities
constexpr double IDLE = 1e-08;
constexpr double NOISE = 1e-06;
constexpr double WALL = 1e-05;

// coopqp.qp_law.safety
constexpr double HALVINGS = 20.0;
constexpr double SHORTEST = 0.0009765625;

// coopqp.qp_law.limit_recovery
constexpr double LEAST_RECOVERY = 0.02;
constexpr double LEAST_MOTION = 0.0001;
constexpr double KEPT = 0.995;

// coopqp.limit
constexpr double OUTSIDE = 1e-09;
constexpr double SHALLOW = 0.001;

// coopqp.limits._keep_apart
constexpr double BACK = 0.1;
constexpr double CORNER_ROWS = 24.0;
constexpr double CORNERS_EACH = 3.0;
constexpr double WITH_CORNERS = 0.005;
constexpr double CORNER_SLAB = 0.002;
constexpr double CORNERS_LATER = 3.0;
constexpr double EVEN = 1e-09;

// coopqp.model.profile
constexpr double RAMP = 0.25;

// coopqp.model.geometry
constexpr double TINY = 1e-14;
constexpr double CONE = 0.02;

// coopqp.model.loop_observer
constexpr double AFTER = 0.2;
constexpr double SOONER = 1.5;
constexpr double SOONEST = 3.0;
constexpr double LOUDER = 5.0;
constexpr double FEELS = 0.3;
constexpr double SLIGHT = 0.0002;
constexpr double MOVES = 0.5;
constexpr double REST = 0.005;
constexpr double TURN_COUNTS = 0.1;
constexpr double STALLED = 0.03;
constexpr double SPANS = 2.0;
constexpr double HAPPENED = 0.0005;
constexpr double FARTHEST = 0.02;
constexpr double SHAPED = 0.9;
constexpr double DOUBT = 0.0005;
constexpr double SAG_ROUNDING = 1e-15;

// coopqp.online.following
constexpr double READING_NOISE = 0.0004;
constexpr double LAG_NOISE = 0.006;
constexpr double INERTIA_NOISE = 0.002;
constexpr double STIFFNESS_NOISE = 0.1;
constexpr double OF_SECOND_DIFFERENCES = 0.73;
constexpr double SINGULAR = 0.001;
constexpr double SUSPICIOUS = 12.0;
constexpr double LEAP = 0.015;

// coopqp.signal
constexpr double ENDLESS = 1e+100;

// coopqp.solver
constexpr double LAST_DIGITS = 1e-14;
constexpr double SAME_ROW = 1e-12;

// coopqp.tasks.manipulability
constexpr double LARGE_PHI = 3.0;
constexpr double REGULAR = 1e-12;

// coopqp.kernel.compiled.Outcome
enum class Status : int {
    Optimal = 0,
    Inaccurate = 1,
    Infeasible = 2,
    Iterations = 3,
    NotFinite = 4,
    Equality = 5,
    Bound = 6,
    Singular = 7,
    Opens = 8,
    Outside = 9,
    Shortened = 10,
    Unproven = 11,
    Clashing = 12,
    Unusual = 13,
};
constexpr int BUSY = -1, RELAXED = 16, STANDS = 32, COMES_BACK = 64, DOUBTFUL = 128;

// coopqp.program.Kind, limit.Bounded, robot.Form and model.profile.KINDS
enum class Kind {
    Point = 0,
    Radial = 1,
    Lean = 2,
    Tilt = 3,
    Rotation = 4,
    Twist = 5,
    Centering = 6,
    Barrier = 7,
    Posture = 8,
    Manipulability = 9,
    Relative = 10,
};
enum class Bounded {
    Velocity = 0,
    Position = 1,
    Braking = 2,
    Lead = 3,
};
enum class Form {
    Hull = 0,
    Box = 1,
    Cylinder = 2,
    Ellipsoid = 3,
};
enum class ProfileKind {
    Step = 0,
    ConstantVelocity = 1,
    Trapezoid = 2,
    Quintic = 3,
};

}  // namespace coopqp
