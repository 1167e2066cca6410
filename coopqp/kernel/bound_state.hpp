// The state that a kernel's arrays belong to, and whether Python has put others in their place. A
// dictionary is asked at the position where it had a key, and by the key only where that is elsewhere
// by now: to ask by keys took a tenth of a tick on NAO.
#pragma once
#include <limits>
#include <utility>
#include <vector>

#include "reading.hpp"

namespace KERNEL_MODULE {

// The attributes of an object, as it has them.
inline nb::dict attributes_of(nb::handle of) {
    return nb::steal<nb::dict>(PyObject_GenericGetDict(of.ptr(), nullptr));
}

class BoundState {
  public:
    // same: dictionaries, keys and the objects there, or None, that make it the one that is bound;
    // usual: those that a step needs beside them; after: those that it leaves where it is optimal;
    // said: those of the command that change where the first of them does, its scale comes last.
    BoundState(nb::object state, nb::object command, nb::list same, nb::list usual, nb::list after,
               nb::list said)
        : state_(std::move(state)), command_(std::move(command)), attributes_(attributes_of(state_)),
          held_(nb::make_tuple(same, usual, after, said)), same_(entries(same)),
          usual_(entries(usual)), after_(entries(after)), said_(entries(said)),
          t_key_(interned("t")), corrected_key_(interned("corrected")), whole_(nb::float_(1.0)),
          t_(entry(attributes_.ptr(), t_key_.ptr(), nullptr)),
          corrected_(entry(attributes_.ptr(), corrected_key_.ptr(), whole_.ptr())) {}

    bool is(nb::handle state) const { return state.is(state_) && hold(same_); }
    bool is_usual() const { return hold(usual_); }
    double t() const { return number(t_); }
    double corrected() const {
        return corrected_.now() == corrected_.value ? 1.0 : number(corrected_);
    }
    const nb::object& command() const { return command_; }

    // Leave what an optimal step leaves, and the time after it.
    //   corrected: what was so before it.
    void leave(double t, double corrected) const {
        put(t_, nb::float_(t).ptr());
        if (corrected != 1.0) put(corrected_, corrected_.value);
        for (const Entry& entry : after_)
            if (entry.now() != entry.value) put(entry, entry.value);
        if (said_.front().now() != said_.front().value)
            for (const Entry& entry : said_) put(entry, entry.value);
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
    std::vector<Entry> same_, usual_, after_, said_;
    nb::object t_key_, corrected_key_, whole_;
    Entry t_, corrected_;
};

}  // namespace KERNEL_MODULE
