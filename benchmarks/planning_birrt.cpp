// The follower's joints of the shelves in closed form, for planning_birrt.py: where the right iiwa14
// has its link 7 while the left one leads (Faria et al. 2018: "Position-based kinematics for 7-DoF
// serial manipulators with global configuration control, joint limit and singularity avoidance").
#include <algorithm>
#include <cmath>

namespace {
constexpr double BASE = 0.36, UPPER = 0.42, FORE = 0.4, HAND = 0.081;
constexpr double ALPHA[7] = {-1, 1, 1, -1, -1, 1, 0};  // of DH, in right angles
constexpr double D[7] = {BASE, 0, UPPER, 0, FORE, 0, HAND};

struct Mat { double a[3][3]; };

Mat operator*(const Mat& x, const Mat& y) {
    Mat z{};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++) z.a[i][j] += x.a[i][k] * y.a[k][j];
    return z;
}
Mat turned(const Mat& x) {
    Mat z{};
    for (int i = 0; i < 3; i++) for (int j = 0; j < 3; j++) z.a[i][j] = x.a[j][i];
    return z;
}
Mat link(double theta, double alpha) {
    const double c = std::cos(theta), s = std::sin(theta), ca = alpha == 0.0, sa = alpha;
    return {{{c, -s * ca, s * sa}, {s, c * ca, -c * sa}, {0, sa, ca}}};
}
double kept(double x) { return std::clamp(x, -1.0 + 1e-4, 1.0 - 1e-4); }
}  // namespace

// lead: seven joints and the follower's elbow angle; turn, shift: its link 7 in the leader's, and
// where its base is; q: its joints; cosines: four numbers that are within -1 and 1 where it reaches.
extern "C" void follow(const double* lead, const double* turn, const double* shift,
                       const double* base, const double* gc, double* q, double* cosines) {
    Mat R{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, T;
    double p[3] = {0, 0, 0};
    for (int i = 0; i < 7; i++) {
        for (int k = 0; k < 3; k++) p[k] += R.a[k][2] * D[i];
        R = R * link(lead[i], ALPHA[i]);
    }
    std::copy(turn, turn + 9, &T.a[0][0]);
    double w[3];  // from the shoulder to the wrist
    const Mat goal = R * T;
    for (int k = 0; k < 3; k++) {
        w[k] = p[k] - base[k] - goal.a[k][2] * HAND - (k == 2 ? BASE : 0.0);
        for (int j = 0; j < 3; j++) w[k] += R.a[k][j] * shift[j];
    }
    const double w2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], far = std::sqrt(w2);
    cosines[0] = (UPPER * UPPER + w2 - FORE * FORE) / (2 * UPPER * far);
    cosines[1] = (w2 - UPPER * UPPER - FORE * FORE) / (2 * UPPER * FORE);
    q[3] = gc[1] * std::acos(kept(cosines[1]));
    const double raised = std::atan2(std::hypot(w[0], w[1]), w[2]) + gc[1] * std::acos(kept(cosines[0]));
    const Mat R03 = link(std::atan2(w[1], w[0]), -1) * link(raised, 1) * link(0, 1);
    Mat K{{{0, -w[2], w[1]}, {w[2], 0, -w[0]}, {-w[1], w[0], 0}}};
    for (auto& row : K.a) for (double& x : row) x /= far;
    const Mat A = K * R03, KA = K * A;
    Mat S;  // of the shoulder, at the elbow angle
    const double c = std::cos(lead[7]), s = std::sin(lead[7]);
    for (int i = 0; i < 3; i++)  // Rodrigues' formula: R03 + K K R03 is the part along w
        for (int j = 0; j < 3; j++) S.a[i][j] = A.a[i][j] * s - KA.a[i][j] * c + R03.a[i][j] + KA.a[i][j];
    q[0] = std::atan2(gc[0] * S.a[1][1], gc[0] * S.a[0][1]);
    cosines[2] = S.a[2][1];
    q[1] = gc[0] * std::acos(kept(S.a[2][1]));
    q[2] = std::atan2(-gc[0] * S.a[2][2], -gc[0] * S.a[2][0]);
    const Mat W = turned(link(q[3], -1)) * turned(S) * goal;
    q[4] = std::atan2(gc[2] * W.a[1][2], gc[2] * W.a[0][2]);
    cosines[3] = W.a[2][2];
    q[5] = gc[2] * std::acos(kept(W.a[2][2]));
    q[6] = std::atan2(gc[2] * W.a[2][1], -gc[2] * W.a[2][0]);
}
