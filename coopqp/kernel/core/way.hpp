// A path on a manifold: two trees that grow towards each other, then shortcuts.
//
// After RRT-Connect (Kuffner and LaValle 2000). A tree grows in a chart: some joints lead on a
// straight line and the others follow by Newton steps, so that a sample need not be on the manifold.
// Where no joint leads, all go towards the sample and are brought back by steps of least norm. Each
// turn takes a chart at random. Edges are made of small steps, each looked at for collisions; they
// are halved on the manifold to a finer step before a path counts, and what does not stand that
// dies with all that grew from it.
#pragma once
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <functional>
#include <vector>

#include "manifold.hpp"

namespace coopqp {

using Points = std::vector<double>;  // configurations one after the other

class Obstruction {
  public:
    virtual ~Obstruction() = default;
    // kinematics: at q.
    virtual bool free(const Kinematics& kinematics, const double* q) = 0;
};

struct Search {
    double step, fine, range;  // of a look in trees and on paths, of a branch [rad, m]
    double seconds;
    long most;  // projections, after which trees do not grow any more
    std::uint64_t seed;
    int shortcuts;                           // tries
    std::vector<double> low, high;           // where samples are taken
    std::vector<std::vector<char>> charts;   // of each joint, whether it leads; no joint: all go
};

struct Found {
    bool found = false;
    Points path;
    double first = 0.0;  // length before shortcuts [rad, m]
    long checks = 0, projections = 0, nodes = 0;
};

class Way {
  public:
    // `wait` is called ten times a second and ends all by throwing, as on Ctrl-C.
    Way(Manifold& manifold, Obstruction& obstruction, const Search& search,
        std::function<void()> wait)
        : m_(manifold), o_(obstruction), s_(search), wait_(std::move(wait)), n_(manifold.n()),
          state_(search.seed), begun_(Clock::now()), told_(begun_) {}

    Found find(const Points& starts, const Points& goals) {
        Tree trees[2];
        for (int side = 0; side < 2; side++) {
            const Points& roots = side ? goals : starts;
            for (std::size_t at = 0; at < roots.size(); at += std::size_t(n_))
                trees[side].add(&roots[at], n_, -1, true);
            trees[side].roots = int(trees[side].parent.size());
        }
        found_ = {};
        if (!straight(trees)) grow(trees);
        found_.nodes = long(trees[0].parent.size() + trees[1].parent.size());
        if (!found_.found) return found_;
        smooth(found_.path);
        return found_;
    }

  private:
    using Clock = std::chrono::steady_clock;
    static constexpr int NEWTON = 6;         // steps of a projection along an edge
    static constexpr double FAR = 1e9;       // no bound of a step
    static constexpr double STRETCH = 2.0;   // of a step, how much longer it may become
    static constexpr double SAME = 1e-6;     // configurations that are one [rad, m]
    static constexpr double NEARLY = 0.999;  // of a part's length, above which it is straight
    static constexpr double WHOLE = 0.5, JOINTS = 0.2;  // shares of shortcuts, of joints in others
    static constexpr double COARSE = 4.0;    // of `fine`, how far apart points are while it is shortened
    static constexpr int ROUNDS = 5;         // of shortcuts
    static constexpr int PASSES = 10;        // of smoothing
    static constexpr double RELAXED = 1.2;   // of a step to the middle
    static constexpr double ROUND = 0.5;     // share of samples round a start and a goal
    static constexpr double BESIDE = 1.0;    // how far beside them [rad, m]
    static constexpr double LEAST = 1.0 / 16;  // share of a step below which none is tried

    struct Tree {
        Points q;
        std::vector<int> parent, nodes;  // nodes: those that branches begin at
        std::vector<char> dead;
        int roots = 0;

        int add(const double* at, int n, int from, bool node) {
            q.insert(q.end(), at, at + n);
            parent.push_back(from);
            dead.push_back(0);
            if (node) nodes.push_back(int(parent.size()) - 1);
            return int(parent.size()) - 1;
        }
        const double* at(int i, int n) const { return &q[std::size_t(i) * std::size_t(n)]; }
    };

    double random() {  // splitmix64
        std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ull);
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
        return double((z ^ (z >> 31)) >> 11) * 0x1.0p-53;
    }
    int random(int count) { return std::min(int(random() * count), count - 1); }

    double apart(const double* a, const double* b) const {
        double sum = 0.0;
        for (int j = 0; j < n_; j++) sum += (a[j] - b[j]) * (a[j] - b[j]);
        return std::sqrt(sum);
    }
    double length(const Points& path) const {
        double sum = 0.0;
        for (std::size_t at = std::size_t(n_); at < path.size(); at += std::size_t(n_))
            sum += apart(&path[at], &path[at - std::size_t(n_)]);
        return sum;
    }

    // Whether q, which was just brought back, is.
    bool free(const double* q) {
        found_.checks++;
        return o_.free(m_.kinematics(), q);
    }
    bool project(double* q, const char* held, double longest = FAR) {
        found_.projections++;
        return m_.project(q, held, NEWTON, longest);
    }

    bool late() {
        const auto now = Clock::now();
        if (std::chrono::duration<double>(now - told_).count() > 0.1) {
            told_ = now;
            wait_();
        }
        return std::chrono::duration<double>(now - begun_).count() > s_.seconds;
    }

    // Between two configurations by halves, the farthest apart first, each looked at; both ends are
    // left out of `out`.
    bool between(const double* a, const double* b, double fine, Points& out) {
        const auto n = std::size_t(n_);
        Points now(a, a + n_), next, middle(n);
        now.insert(now.end(), b, b + n_);
        for (int depth = 0;; depth++) {
            const std::size_t last = now.size() - n;
            next.clear();
            for (std::size_t at = 0; at < last; at += n) {
                const double *one = &now[at], *other = one + n_;
                next.insert(next.end(), one, other);
                const double whole = apart(one, other), most = 0.75 * whole;
                if (whole <= fine) continue;
                if (depth > 16) return false;
                for (std::size_t j = 0; j < n; j++) middle[j] = 0.5 * (one[j] + other[j]);
                if (!project(middle.data(), nullptr, most) || apart(one, middle.data()) > most ||
                    apart(middle.data(), other) > most || !free(middle.data()))
                    return false;
                next.insert(next.end(), middle.begin(), middle.end());
            }
            next.insert(next.end(), now.begin() + long(last), now.end());
            const bool done = next.size() == now.size();
            now.swap(next);
            if (done) break;
        }
        out.insert(out.end(), now.begin() + n_, now.end() - n_);
        return true;
    }

    // From a start to a goal without a search.
    bool straight(Tree* trees) {
        for (int i : trees[0].nodes)
            for (int k : trees[1].nodes) {
                const double *a = trees[0].at(i, n_), *b = trees[1].at(k, n_);
                Points inner;
                if (!between(a, b, s_.fine, inner)) continue;
                found_.path.assign(a, a + n_);
                found_.path.insert(found_.path.end(), inner.begin(), inner.end());
                found_.path.insert(found_.path.end(), b, b + n_);
                found_.first = length(found_.path);
                const Segments segments = segments_of(found_.path, true);
                found_.path = points_of(shortened(segments, segments));
                return found_.found = true;
            }
        return false;
    }

    void grow(Tree* trees) {
        Points target(static_cast<std::size_t>(n_));
        for (int turn = 0; !late() && found_.projections < s_.most; turn++) {
            Tree &one = trees[turn % 2], &other = trees[1 - turn % 2];
            const std::vector<char>& chart = s_.charts[std::size_t(random(int(s_.charts.size())))];
            sample(trees, target.data());
            const int from = nearest(one, target.data(), chart);
            if (from < 0) return;
            const int to = extend(one, from, target.data(), chart, s_.range);
            if (to == from) continue;
            const Points there(one.at(to, n_), one.at(to, n_) + n_);
            const int near = nearest(other, there.data(), {});
            if (near < 0) return;
            const int met = extend(other, near, there.data(), chart, FAR);
            if (apart(other.at(met, n_), there.data()) > SAME) continue;
            if (joined(trees, turn % 2 ? met : to, turn % 2 ? to : met)) return;
        }
    }

    // Anywhere inside the limits, or round a start and a goal: many joints may turn so far that what
    // lies between them is next to nothing of that.
    void sample(const Tree* trees, double* to) {
        const bool round = random() < ROUND;
        const double *a = nullptr, *b = nullptr;
        if (round) {
            a = trees[0].at(random(trees[0].roots), n_);
            b = trees[1].at(random(trees[1].roots), n_);
        }
        for (int j = 0; j < n_; j++) {
            double low = s_.low[std::size_t(j)], high = s_.high[std::size_t(j)];
            if (round) {
                low = std::max(low, std::min(a[j], b[j]) - BESIDE);
                high = std::min(high, std::max(a[j], b[j]) + BESIDE);
            }
            to[j] = low + random() * (high - low);
        }
    }

    // Of the branches' beginnings, by the joints that lead; all where none does.
    int nearest(const Tree& tree, const double* q, const std::vector<char>& chart) const {
        int best = -1;
        double least = 1e300;
        const bool all = !leads(chart);
        for (int i : tree.nodes) {
            if (tree.dead[std::size_t(i)]) continue;
            const double* at = tree.at(i, n_);
            double sum = 0.0;
            for (int j = 0; j < n_; j++)
                if (all || chart[std::size_t(j)]) sum += (at[j] - q[j]) * (at[j] - q[j]);
            if (sum < least) {
                least = sum;
                best = i;
            }
        }
        return best;
    }

    static bool leads(const std::vector<char>& chart) {
        return std::find(chart.begin(), chart.end(), 1) != chart.end();
    }

    // Grow towards a target, as far as `range`; the last point, which may be where it began. Where
    // joints lead, the others begin a step as they went in the one before.
    int extend(Tree& tree, int from, const double* target, const std::vector<char>& chart,
               double range) {
        const bool led = leads(chart);
        int at = from;
        double gone = 0.0, since = 0.0, share = 1.0;
        Points q(static_cast<std::size_t>(n_)), way(q), rate(q);  // rate: of those that follow
        while (gone < range) {
            const double* here = tree.at(at, n_);
            double rest = 0.0;
            for (std::size_t j = 0; j < q.size(); j++) {
                way[j] = !led || chart[j] ? target[j] - here[j] : 0.0;
                rest += way[j] * way[j];
            }
            rest = std::sqrt(rest);
            if (rest < SAME) break;
            const double part = std::min(1.0, share * s_.step / rest);
            for (std::size_t j = 0; j < q.size(); j++)
                q[j] = here[j] + part * (!led || chart[j] ? way[j] : rest * rate[j]);
            const bool closed = project(q.data(), led ? chart.data() : nullptr, STRETCH * s_.step);
            const double moved = closed ? apart(q.data(), here) : 0.0;
            if (!closed || moved > STRETCH * s_.step) {
                if ((share *= 0.5) < LEAST) break;
                continue;
            }
            if (!led && apart(q.data(), target) > rest - 0.2 * part * rest) break;
            if (!free(q.data())) break;
            for (std::size_t j = 0; j < q.size(); j++) rate[j] = (q[j] - here[j]) / (part * rest);
            share = std::min(1.0, 2.0 * share);
            gone += moved;
            since += moved;
            const bool node = since > 0.5 * s_.range;
            if (node) since = 0.0;
            at = tree.add(q.data(), n_, at, node);
        }
        if (at != from && (tree.nodes.empty() || tree.nodes.back() != at)) tree.nodes.push_back(at);
        return at;
    }

    // Whether the path through two points that are one stands a finer look; else what does not dies.
    bool joined(Tree* trees, int of_start, int of_goal) {
        Points path;
        if (!traced(trees, of_start, of_goal, COARSE * s_.fine, path)) return false;
        found_.first = length(path);
        Segments good = shortened(segments_of(path, false), {});
        if (good.empty()) {
            if (!traced(trees, of_start, of_goal, s_.fine, path)) return false;
            const Segments segments = segments_of(path, true);
            good = shortened(segments, segments);
        }
        found_.path = points_of(good);
        return found_.found = true;
    }

    // The path through two points that are one, its points no farther apart than `fine`; where there
    // is none, what does not stand it dies.
    bool traced(Tree* trees, int of_start, int of_goal, double fine, Points& path) {
        Points back;
        if (!branch(trees[0], of_start, fine, path) || !branch(trees[1], of_goal, fine, back))
            return false;
        for (std::size_t at = back.size() - std::size_t(n_); at > 0;) {  // the last is there already
            at -= std::size_t(n_);
            path.insert(path.end(), back.begin() + long(at), back.begin() + long(at) + n_);
        }
        return true;
    }

    // From a root to a point of a tree.
    bool branch(Tree& tree, int to, double fine, Points& path) {
        std::vector<int> way;
        for (int i = to; i >= 0; i = tree.parent[std::size_t(i)]) way.push_back(i);
        path.assign(tree.at(way.back(), n_), tree.at(way.back(), n_) + n_);
        way.pop_back();
        for (; !way.empty(); way.pop_back()) {
            const double* q = tree.at(way.back(), n_);
            if (!between(Points(path.end() - n_, path.end()).data(), q, fine, path)) {
                kill(tree, way.back());
                return false;
            }
            path.insert(path.end(), q, q + n_);
        }
        return true;
    }

    static void kill(Tree& tree, int i) {
        tree.dead[std::size_t(i)] = 1;
        for (std::size_t k = std::size_t(i) + 1; k < tree.parent.size(); k++)
            if (tree.parent[k] >= 0 && tree.dead[std::size_t(tree.parent[k])]) tree.dead[k] = 1;
    }

    // A point of a path, those between it and the one before, and whether these are known.
    struct Segment {
        Points inner, to;
        bool known;
    };
    using Segments = std::vector<Segment>;

    // Over those of a path's points that are about so far apart, with the points between where
    // these are near enough to be known.
    Segments segments_of(const Points& path, bool known) const {
        const auto n = std::size_t(n_);
        Segments segments;
        Points inner;
        for (std::size_t at = 0; at < path.size(); at += n) {
            const double* q = &path[at];
            if (!at || at + 2 * n > path.size() ||
                apart(segments.back().to.data(), q + n) > COARSE * s_.fine) {
                segments.push_back({known ? inner : Points(), {q, q + n}, !at || known});
                inner.clear();
            } else {
                inner.insert(inner.end(), q, q + n);
            }
        }
        return segments;
    }

    static Points points_of(const Segments& segments) {
        Points path;
        for (const Segment& segment : segments) {
            path.insert(path.end(), segment.inner.begin(), segment.inner.end());
            path.insert(path.end(), segment.to.begin(), segment.to.end());
        }
        return path;
    }

    // Shortened on few of its points, in rounds after which it is looked at between them. A round
    // that does not stand that is undone, to what is known to be good; all where nothing is.
    Segments shortened(Segments segments, Segments good) {
        for (int round = 0; round < ROUNDS; round++) {
            shorten(segments, (s_.shortcuts + round) / ROUNDS);
            if (stands(segments))
                good = segments;
            else if (good.empty())
                break;
            else
                segments = good;
        }
        return good;
    }

    bool stands(Segments& segments) {
        for (std::size_t k = 1; k < segments.size(); k++) {
            Segment& segment = segments[k];
            if (!segment.known &&
                !between(segments[k - 1].to.data(), segment.to.data(), s_.fine, segment.inner))
                return false;
            segment.known = true;
        }
        return true;
    }

    // Ways between two points of the path at random, where they are shorter: straight ones, and ones
    // on which some joints go straight and the others as they went (partial shortcuts after
    // Geraerts and Overmars 2007).
    void shorten(Segments& segments, int tries) {
        std::vector<double> at;  // length up to each point
        for (int i = 0; i < tries && !late(); i++) {
            const std::size_t count = segments.size();
            if (count < 3) return;
            if (at.size() != count) {
                at.assign(count, 0.0);
                for (std::size_t k = 1; k < count; k++)
                    at[k] = at[k - 1] + apart(segments[k].to.data(), segments[k - 1].to.data());
            }
            const double u = random() * at.back(), v = random() * at.back();
            const auto index = [&](double x) {
                return std::size_t(std::lower_bound(at.begin(), at.end(), x) - at.begin());
            };
            const std::size_t a = index(std::min(u, v)), b = index(std::max(u, v));
            const double *first = segments[a].to.data(), *last = segments[b].to.data();
            if (b < a + 2 || apart(first, last) > NEARLY * (at[b] - at[a])) continue;
            Points inner(first, first + n_);
            if (random() < WHOLE ? !between(first, last, COARSE * s_.fine, inner)
                                 : !partly(segments, at, a, b, inner))
                continue;
            inner.insert(inner.end(), last, last + n_);
            if (length(inner) > at[b] - at[a] - SAME) continue;
            const auto n = std::size_t(n_);
            Segments made;
            for (std::size_t q = n; q < inner.size(); q += n)
                made.push_back({{}, {&inner[q], &inner[q] + n}, false});
            segments.erase(segments.begin() + long(a + 1), segments.begin() + long(b + 1));
            segments.insert(segments.begin() + long(a + 1), made.begin(), made.end());
            at.clear();
        }
    }

    // From point a to point b of a path with some joints nearer to straight lines, a few points
    // before those between them.
    bool partly(const Segments& segments, const std::vector<double>& at, std::size_t a, std::size_t b,
                Points& inner) {
        const auto n = std::size_t(n_);
        const double most = at[b] - at[a], by = random() < 0.5 ? 1.0 : random();
        std::vector<double> share(n);
        for (double& x : share) x = random() < JOINTS ? by : 0.0;
        Points now;
        for (std::size_t k = a; k <= b; k++)
            now.insert(now.end(), segments[k].to.begin(), segments[k].to.end());
        const std::size_t last = b - a;
        const double *first = &now[0], *end = &now[last * n];
        for (std::size_t stride = 16; stride > 0; stride /= 2) {
            const double* before = first;
            double gone = 0.0;
            for (std::size_t k = stride; k < last; k += stride) {
                double* q = &now[k * n];
                if (stride == 16 || k / stride % 2) {
                    const double part = (at[a + k] - at[a]) / most;
                    for (std::size_t j = 0; j < n; j++)
                        q[j] += share[j] * (first[j] + part * (end[j] - first[j]) - q[j]);
                    if (!project(q, nullptr) || !free(q)) return false;
                }
                gone += apart(before, q);
                before = q;
            }
            if (gone + apart(before, end) > most - SAME) return false;
        }
        for (const double* q = first; q < end; q += n) {
            if (!between(q, q + n, COARSE * s_.fine, inner)) return false;
            if (q + n < end) inner.insert(inner.end(), q + n, q + 2 * n);
        }
        return true;
    }

    // Round the corners that shortcuts leave: points at a step's distance go to the middle between
    // their neighbours. What the finer look does not stand goes back to where it was.
    void smooth(Points& path) {
        const auto n = std::size_t(n_);
        std::vector<std::size_t> index{0};
        for (std::size_t k = 1; k < path.size() / n; k++)
            if ((k + 1) * n == path.size() || apart(&path[k * n], &path[index.back() * n]) > s_.step)
                index.push_back(k);
        const std::size_t count = index.size();
        Points rough, q(n);
        for (std::size_t k : index)
            rough.insert(rough.end(), path.begin() + long(k * n), path.begin() + long((k + 1) * n));
        for (int pass = 0; pass < PASSES && !late(); pass++)
            for (std::size_t i = 1; i + 1 < count; i++) {
                double* here = &rough[i * n];
                for (std::size_t j = 0; j < n; j++)
                    q[j] = here[j] + RELAXED * (0.5 * (here[j - n] + here[j + n]) - here[j]);
                if (project(q.data(), nullptr) && free(q.data()))
                    std::copy(q.begin(), q.end(), here);
            }
        std::vector<Points> inner(count);
        std::vector<char> good(count, 0), old(count, 0);
        old[0] = old[count - 1] = 1;
        for (bool again = true; again;) {
            again = false;
            for (std::size_t i = 0; i + 1 < count; i++) {
                if (good[i]) continue;
                inner[i].clear();
                good[i] = 1;
                if (between(&rough[i * n], &rough[(i + 1) * n], s_.fine, inner[i])) continue;
                if (old[i] && old[i + 1]) {
                    inner[i].assign(path.begin() + long((index[i] + 1) * n),
                                    path.begin() + long(index[i + 1] * n));
                    continue;
                }
                again = true;
                for (std::size_t k : {i, i + 1}) {
                    if (old[k]) continue;
                    old[k] = 1;
                    std::copy_n(&path[index[k] * n], n, &rough[k * n]);
                    good[k - 1] = good[k] = 0;
                }
            }
        }
        Points made;
        for (std::size_t i = 0; i < count; i++) {
            made.insert(made.end(), rough.begin() + long(i * n), rough.begin() + long((i + 1) * n));
            made.insert(made.end(), inner[i].begin(), inner[i].end());
        }
        if (length(made) < length(path)) path = std::move(made);
    }

    Manifold& m_;
    Obstruction& o_;
    const Search& s_;
    std::function<void()> wait_;
    int n_;
    std::uint64_t state_;
    Clock::time_point begun_, told_;
    Found found_;
};

}  // namespace coopqp
