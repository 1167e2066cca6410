// The robot as flat numbers: joints, arms, and where each joint's velocity lies among the lanes.
//
// Joint axes are turned to z beforehand. Velocities are stored by arm: lanes 0.. hold the joints of
// arm 0 and all that move more than one arm, then come the other arms' own joints, each arm from a
// multiple of four lanes on, at last the joints that move no arm. Lanes in between stay zero.
#pragma once
#include <vector>

#include "lanes.hpp"

namespace coopqp {

constexpr int TWIST = 8;  // lanes of a twist, of which 6 are used

struct Placement {
    double R[9], p[3];  // row by row
};

struct Joint {
    int parent;  // -1: the world
    bool slides;
    Placement at;
    int lane;
};

struct Arm {
    int tip;  // joint that carries the object frame; -1: the world
    Placement at;
    double alpha;
    std::vector<int> base, own;  // joints that move it: in block 0, in its own
    int first = 0;               // lane of its own block
    int own_blocks = 0;
    double* J_base = nullptr;  // (6, lanes of block 0)
    double* J_own = nullptr;   // (6, lanes of its own block); arm 0 has none
    std::vector<int> lanes;    // of the joints that move it, base first
    double* columns = nullptr;  // the same Jacobian joint by joint, (joints, 8), of which 6 are used
};

struct Model {
    std::vector<Joint> joints;
    std::vector<Arm> arms;
    int holding = 0;      // the first so many arms hold the object
    int base_lanes = 0;   // in use of block 0
    int base_blocks = 0;  // of four lanes
    int blocks = 0;       // all
    std::vector<int> loose_lanes;  // of joints that no loop sees

    int n() const { return int(joints.size()); }
    int loops() const { return holding - 1; }
    const double* J_own(int arm, int row) const {
        return arms[arm].J_own + row * LANES * arms[arm].own_blocks;
    }
    const double* J_base(int arm, int row) const {
        return arms[arm].J_base + row * LANES * base_blocks;
    }
};

// Choose the lanes, once parents and tips are known.
inline void lay_out(Model& m, Arena& arena) {
    const int n = m.n();
    std::vector<std::vector<int>> moves(m.arms.size());
    std::vector<int> count(n, 0), owner(n, -1);
    for (std::size_t i = 0; i < m.arms.size(); i++)
        for (int j = m.arms[i].tip; j >= 0; j = m.joints[j].parent) {
            moves[i].insert(moves[i].begin(), j);
            count[j]++;
            owner[j] = int(i);
        }
    int lane = 0;
    for (int j = 0; j < n; j++)
        if (count[j] > 1 || owner[j] == 0) m.joints[j].lane = lane++;
    m.base_lanes = lane;
    m.base_blocks = blocks_of(lane > 0 ? lane : 1);
    lane = m.base_blocks * LANES;
    for (std::size_t i = 0; i < m.arms.size(); i++) {
        Arm& arm = m.arms[i];
        arm.first = lane;
        for (int j : moves[i]) {
            const bool own = i > 0 && count[j] == 1;
            (own ? arm.own : arm.base).push_back(j);
            if (own) m.joints[j].lane = lane++;
            if (own && int(i) >= m.holding) m.loose_lanes.push_back(m.joints[j].lane);
        }
        lane = padded(lane);
        arm.own_blocks = (lane - arm.first) / LANES;
        arm.J_base = arena.take(6 * LANES * m.base_blocks);
        if (arm.own_blocks) arm.J_own = arena.take(6 * LANES * arm.own_blocks);
        for (int j : arm.base) arm.lanes.push_back(m.joints[j].lane);
        for (int j : arm.own) arm.lanes.push_back(m.joints[j].lane);
        arm.columns = arena.take(TWIST * (arm.lanes.size() + 1));
    }
    for (int j = 0; j < n; j++)
        if (!count[j]) {
            m.joints[j].lane = lane++;
            m.loose_lanes.push_back(m.joints[j].lane);
        }
    m.blocks = blocks_of(lane);
}

}  // namespace coopqp
