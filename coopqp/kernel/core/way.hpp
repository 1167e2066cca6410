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
    virtual bool free(const double* q) = 0;
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
        found_.first = length(found_.path);
        shorten_coarsely(found_.path);
        smooth(found_.path);
        return found_;
    }

  private:
    using Clock = std::chrono::steady_clock;
    static constexpr int NEWTON = 6;         // steps of a projection along an edge
    static constexpr double STRETCH = 2.0;   // of a step, how much longer it may become
    static constexpr double SAME = 1e-6;     // configurations that are one [rad, m]
    static constexpr double NEARLY = 0.999;  // of a part's length, above which it is straight
    static constexpr double WHOLE = 0.5, JOINTS = 0.2;  // shares of shortcuts, of joints in others
    static constexpr double COARSE = 4.0;    // of `fine`, how far apart points are while it is shortened
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

    bool free(const double* q) {
        found_.checks++;
        return o_.free(q);
    }
    bool project(double* q, const char* held) {
        found_.projections++;
        return m_.project(q, held, NEWTON);
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
                if (!project(middle.data(), nullptr) || apart(one, middle.data()) > most ||
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
            const int met = extend(other, near, there.data(), chart, 1e9);
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

    // Grow towards a target, as far as `range`; the last point, which may be where it began.
    int extend(Tree& tree, int from, const double* target, const std::vector<char>& chart,
               double range) {
        const bool led = leads(chart);
        int at = from;
        double gone = 0.0, since = 0.0, share = 1.0;
        Points q(static_cast<std::size_t>(n_)), way(q);
        while (gone < range) {
            const double* here = tree.at(at, n_);
            double rest = 0.0;
            for (int j = 0; j < n_; j++) {
                way[std::size_t(j)] = !led || chart[std::size_t(j)] ? target[j] - here[j] : 0.0;
                rest += way[std::size_t(j)] * way[std::size_t(j)];
            }
            rest = std::sqrt(rest);
            if (rest < SAME) break;
            const double part = std::min(1.0, share * s_.step / rest);
            for (int j = 0; j < n_; j++) q[std::size_t(j)] = here[j] + part * way[std::size_t(j)];
            const bool closed = project(q.data(), led ? chart.data() : nullptr);
            const double moved = closed ? apart(q.data(), here) : 0.0;
            if (!closed || moved > STRETCH * s_.step) {
                if ((share *= 0.5) < LEAST) break;
                continue;
            }
            if (!led && apart(q.data(), target) > rest - 0.2 * part * rest) break;
            if (!free(q.data())) break;
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
        std::vector<int> way;
        for (int i = of_start; i >= 0; i = trees[0].parent[std::size_t(i)]) way.push_back(i);
        std::reverse(way.begin(), way.end());
        for (std::size_t i = 0; i < way.size(); i++) {
            const double* q = trees[0].at(way[i], n_);
            if (i && !between(&path[path.size() - std::size_t(n_)], q, s_.fine, emptied()))
                return kill(trees[0], way[i]);
            append(path, q);
        }
        Points back;
        way.clear();
        for (int i = of_goal; i >= 0; i = trees[1].parent[std::size_t(i)]) way.push_back(i);
        std::reverse(way.begin(), way.end());
        for (std::size_t i = 0; i < way.size(); i++) {
            const double* q = trees[1].at(way[i], n_);
            if (i && !between(&back[back.size() - std::size_t(n_)], q, s_.fine, emptied()))
                return kill(trees[1], way[i]);
            append(back, q);
        }
        for (std::size_t at = back.size() - std::size_t(n_); at > 0;) {  // the last is there already
            at -= std::size_t(n_);
            path.insert(path.end(), back.begin() + long(at), back.begin() + long(at) + n_);
        }
        found_.path = std::move(path);
        return found_.found = true;
    }

    // Where points between go until all of them are known.
    Points& emptied() {
        inner_.clear();
        return inner_;
    }
    void append(Points& path, const double* q) {
        path.insert(path.end(), inner_.begin(), inner_.end());
        inner_.clear();
        path.insert(path.end(), q, q + n_);
    }

    bool kill(Tree& tree, int i) {
        inner_.clear();
        tree.dead[std::size_t(i)] = 1;
        for (std::size_t k = std::size_t(i) + 1; k < tree.parent.size(); k++)
            if (tree.parent[k] >= 0 && tree.dead[std::size_t(tree.parent[k])]) tree.dead[k] = 1;
        return false;
    }

    // Shortened on few of its points, between which it is looked at once, at the end; where that
    // does not stand it is shortened on all of them.
    void shorten_coarsely(Points& path) {
        const auto n = std::size_t(n_);
        Points few = thinned(path, COARSE * s_.fine), made(path.begin(), path.begin() + n_);
        shorten(few, COARSE * s_.fine);
        for (std::size_t at = n; at < few.size(); at += n) {
            if (!between(&few[at - n], &few[at], s_.fine, made)) return shorten(path, s_.fine);
            made.insert(made.end(), few.begin() + long(at), few.begin() + long(at + n));
        }
        path = std::move(made);
    }

    // Of its points those that are about so far apart; the last one in any case.
    Points thinned(const Points& path, double step) const {
        const auto n = std::size_t(n_);
        Points few(path.begin(), path.begin() + n_);
        for (std::size_t at = n; at < path.size(); at += n)
            if (at + 2 * n > path.size() || apart(&few[few.size() - n], &path[at + n]) > step)
                few.insert(few.end(), path.begin() + long(at), path.begin() + long(at + n));
        return few;
    }

    // Ways between two points of the path at random, where they are shorter: straight ones, and ones
    // on which some joints go straight and the others as they went (partial shortcuts after
    // Geraerts and Overmars 2007). Their points are at most so far apart as `fine`.
    void shorten(Points& path, double fine) {
        const auto n = std::size_t(n_);
        std::vector<double> at;  // length up to each point
        for (int i = 0; i < s_.shortcuts && !late(); i++) {
            const std::size_t count = path.size() / n;
            if (count < 3) return;
            if (at.size() != count) {
                at.assign(count, 0.0);
                for (std::size_t k = 1; k < count; k++)
                    at[k] = at[k - 1] + apart(&path[k * n], &path[(k - 1) * n]);
            }
            const double u = random() * at.back(), v = random() * at.back();
            const auto index = [&](double x) {
                return std::size_t(std::lower_bound(at.begin(), at.end(), x) - at.begin());
            };
            const std::size_t a = index(std::min(u, v)), b = index(std::max(u, v));
            if (b < a + 2 || apart(&path[a * n], &path[b * n]) > NEARLY * (at[b] - at[a])) continue;
            Points inner;
            if (random() < WHOLE ? !between(&path[a * n], &path[b * n], fine, inner)
                                 : !partly(path, at, a, b, fine, inner))
                continue;
            Points made(path.begin(), path.begin() + long((a + 1) * n));
            made.insert(made.end(), inner.begin(), inner.end());
            made.insert(made.end(), path.begin() + long(b * n), path.end());
            if (length(made) > at.back() - SAME) continue;
            path = std::move(made);
            at.clear();
        }
    }

    // From point a to point b of a path with some joints nearer to straight lines, a few points
    // before those between them.
    bool partly(const Points& path, const std::vector<double>& at, std::size_t a, std::size_t b,
                double fine, Points& inner) {
        const auto n = std::size_t(n_);
        const double most = at[b] - at[a], by = random() < 0.5 ? 1.0 : random();
        std::vector<double> share(n);
        for (double& x : share) x = random() < JOINTS ? by : 0.0;
        Points now(path.begin() + long(a * n), path.begin() + long((b + 1) * n));
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
            if (!between(q, q + n, fine, inner)) return false;
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
    Points inner_;
};

}  // namespace coopqp
