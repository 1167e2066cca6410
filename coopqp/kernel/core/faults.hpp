// Faults that tests put into a tick, to see that the check catches them. In the shipped build there
// are none: the compiler sees a constant.
#pragma once

namespace coopqp {

enum class Fault {
    None,
    WrongDirection,   // a basis of the loops' null space that is off
    StaleFactor,      // the loops of the tick before
    WrongRow,         // a task row that is off, in reduced coordinates
    WrongMultiplier,  // of an active limit
    WrongSide,        // the loops' right side
    LimitsForgotten,  // the answer before limits were looked at
    WrongAnswer,      // a step along a free direction
    ActiveForgotten,  // a limit that binds, left out of the certificate
    WrongShare,       // of a scaled task, less than could be
    WrongWay,         // what a share of a scaled task moves
    FalseProof,       // that limits leave nothing, where they do
};

#ifdef COOPQP_FAULTS
inline Fault injected = Fault::None;
inline bool in_limit_recovery = false, in_limit_recovery_alone = false;  // where the tick is, and the fault
inline bool fault(Fault kind) { return injected == kind && (in_limit_recovery || !in_limit_recovery_alone); }
struct WithinLimitRecovery {
    WithinLimitRecovery() { in_limit_recovery = true; }
    ~WithinLimitRecovery() { in_limit_recovery = false; }
};
#else
inline constexpr bool fault(Fault) { return false; }
struct WithinLimitRecovery {};
#endif

}  // namespace coopqp
