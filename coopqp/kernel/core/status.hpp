// What became of a tick of the kernel; coopqp.kernel.law says which are handed to the plain law.
#pragma once

namespace coopqp {

enum class Status : int {
    Optimal = 0,
    Inaccurate,   // feasible, but the certificate is short of digits
    Infeasible,   // the first level's constraints leave nothing, as is proved
    Iterations,   // the active set changed too often
    NotFinite,    // the state or the answer has NaN or infinite values
    Equality,     // the answer breaks the loop closure
    Bound,        // the answer breaks a limit
    Singular,     // loop or hard rows that are independent in general are not so here
    Opens,        // hardly a step leaves the loops within their budget
    Outside,      // a joint is outside its limits; no way back does all of the drift correction
    Shortened,    // optimal, but for the length of the step
    Unproven,     // no answer was found, and no proof that there is none
    Clashing,     // the first level's constraints leave nothing, by less than they may give way
};

}  // namespace coopqp
