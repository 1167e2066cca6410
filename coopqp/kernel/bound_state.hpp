// The state that a kernel's arrays belong to, and whether Python has put others in their place. A
// dictionary is asked at the position where it had a key, and by the key only where that is elsewhere
// by now: to ask by keys took a tenth of a tick on NAO.
#pragma once
#include <algorithm>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <utility>
#include <vector>

#include "reading.hpp"

namespace KERNEL_MODULE {

// The attributes of an object, as it has them.
inline nb::dict attributes_of(nb::handle of) {
    return nb::steal<nb::dict>(PyObject_GenericGetDict(of.ptr(), nullptr));
}

// Another number after each change of any dictionary, by PEP 509; 0 where Python does not tell.
inline std::uint64_t version_of([[maybe_unused]] PyObject* dict) {
#if !defined(Py_LIMITED_API) && PY_VERSION_HEX < 0x030C0000
    return reinterpret_cast<PyDictObject*>(dict)->ma_version_tag;
#else
    return 0;
#endif
}

class BoundState {
  public:
    // same: dictionaries, keys and the objects there, or None, that make it the one that is bound;
    // usual: those that a step needs beside them; said: those of the command, its scale last, that an
    // optimal one leaves.
    BoundState(nb::object state, nb::object command, nb::list same, nb::list usual, nb::list said)
        : state_(std::move(state)), command_(std::move(command)), attributes_(attributes_of(state_)),
          held_(nb::make_tuple(same, usual, said)), same_(entries(same)), usual_(entries(usual)),
          said_(entries(said)), seen_(all_of({&same_, &usual_})), said_seen_(all_of({&said_})),
          t_key_(interned("t")), corrected_key_(interned("corrected")),
          due_key_(interned("jacobians_due")), whole_(nb::float_(1.0)),
          t_(entry(attributes_.ptr(), t_key_.ptr(), nullptr)),
          corrected_(entry(attributes_.ptr(), corrected_key_.ptr(), whole_.ptr())),
          due_(entry(attributes_.ptr(), due_key_.ptr(), Py_True)) {}

    bool is(nb::handle state) const { return state.is(state_) && hold(same_); }

    // Whether a step may begin, when, and what was corrected in the tick before; nothing is asked
    // where no dictionary has changed since the last step.
    bool begins(nb::handle state, double& t, double& corrected) {
        known_ = state.is(state_) && same(seen_);
        t = known_ ? left_at_ : number(t_);
        corrected = known_ || corrected_.now() == corrected_.value ? 1.0 : number(corrected_);
        return known_ || (is(state) && hold(usual_));
    }
    const nb::object& command() const { return command_; }

    // Leave what an optimal step leaves, and the time after it.
    //   corrected: what was so before it. alone: whether nobody else had the GIL meanwhile.
    void leave(double t, double corrected, bool alone) {
        put(t_, nb::float_(t).ptr());
        left_at_ = t;
        if (corrected != 1.0) put(corrected_, corrected_.value);
        if (!known_ && due_.now() != due_.value) put(due_, due_.value);
        for (Seen& one : seen_) one.version = alone ? version_of(one.of) : 0;
        if (same(said_seen_)) return;
        const bool holds = hold(said_);
        for (const Entry& entry : said_)
            if (!holds) put(entry, entry.value);
        for (Seen& one : said_seen_) one.version = holds ? version_of(one.of) : 0;
    }
    void leave_scale(double scale) const { put(said_.back(), nb::float_(scale).ptr()); }

    // For Python's collector.
    int visit(visitproc visit, void* arg) const {
        Py_VISIT(state_.ptr());
        Py_VISIT(command_.ptr());
        Py_VISIT(attributes_.ptr());
        Py_VISIT(held_.ptr());
        return 0;
    }

  private:
    struct Entry {
        PyObject *of, *key, *value;
        Py_ssize_t at;  // the key's position, or -1

        PyObject* now() const {
            Py_ssize_t place = at;
            PyObject *found, *held;
            if (at >= 0 && PyDict_Next(of, &place, &found, &held) && found == key) return held;
            return PyDict_GetItem(of, key);
        }
    };

    static Entry entry(PyObject* of, PyObject* key, PyObject* value) {
        Py_ssize_t place = 0, at = 0;
        PyObject *found, *held;
        while (PyDict_Next(of, &place, &found, &held)) {
            if (found == key) return {of, key, value, at};
            at = place;
        }
        return {of, key, value, -1};
    }

    static Entry one(nb::handle listed) {
        return entry(nb::handle(listed[0]).ptr(), nb::handle(listed[1]).ptr(),
                     nb::handle(listed[2]).ptr());
    }

    static std::vector<Entry> entries(const nb::list& listed) {
        std::vector<Entry> found;
        for (nb::handle each : listed) found.push_back(one(each));
        return found;
    }

    static nb::object interned(const char* name) {
        return nb::steal(PyUnicode_InternFromString(name));
    }

    // A dictionary, and its version when it was as it should be.
    struct Seen {
        PyObject* of;
        std::uint64_t version;
    };

    static std::vector<Seen> all_of(std::initializer_list<const std::vector<Entry>*> parts) {
        std::vector<Seen> found;
        for (const auto* entries : parts)
            for (const Entry& entry : *entries) {
                const auto is_here = [&entry](const Seen& one) { return one.of == entry.of; };
                if (std::none_of(found.begin(), found.end(), is_here)) found.push_back({entry.of, 0});
            }
        return found;
    }

    static bool same(const std::vector<Seen>& seen) {
        for (const Seen& one : seen)
            if (one.version == 0 || one.version != version_of(one.of)) return false;
        return true;
    }

    static bool hold(const std::vector<Entry>& entries) {
        for (const Entry& entry : entries) {
            PyObject* now = entry.now();
            if ((now ? now : Py_None) != entry.value) return false;
        }
        return true;
    }

    static void put(const Entry& entry, PyObject* value) {
        if (PyDict_SetItem(entry.of, entry.key, value)) throw nb::python_error();
    }

    // NaN where it is none.
    static double number(const Entry& entry) {
        PyObject* now = entry.now();
        if (!now || !PyFloat_Check(now)) return std::numeric_limits<double>::quiet_NaN();
        return PyFloat_AsDouble(now);
    }

    nb::object state_, command_;
    nb::dict attributes_;
    nb::tuple held_;
    std::vector<Entry> same_, usual_, said_;
    std::vector<Seen> seen_, said_seen_;  // all dictionaries of them
    nb::object t_key_, corrected_key_, due_key_, whole_;
    Entry t_, corrected_, due_;
    bool known_ = false;  // whether a step has begun where the last one had left all
    double left_at_ = 0.0;
};

}  // namespace KERNEL_MODULE
