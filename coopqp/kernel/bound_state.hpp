// The state that a kernel's arrays belong to, and whether Python has put others in their place. A
// dictionary is asked at the position where it had a key, and by the key only where that is elsewhere
// by now: to ask by keys took a tenth of a tick on NAO.
#pragma once
#include <limits>
#include <utility>
#include <vector>

#include "reading.hpp"

namespace KERNEL_MODULE {

class BoundState {
  public:
    // same: dictionaries, keys and the objects there, or None, that make it the one that is bound;
    // usual: those that a step needs beside them.
    BoundState(nb::object state, nb::dict attributes, nb::list same, nb::list usual)
        : state_(std::move(state)), attributes_(std::move(attributes)),
          held_(nb::make_tuple(same, usual)), same_(entries(same)), usual_(entries(usual)),
          t_key_(interned("t")), corrected_key_(interned("corrected")),
          t_(entry(attributes_.ptr(), t_key_.ptr(), nullptr)),
          corrected_(entry(attributes_.ptr(), corrected_key_.ptr(), nullptr)) {}

    bool is(nb::handle state) const { return state.is(state_) && hold(same_); }
    bool is_usual() const { return hold(usual_); }
    double t() const { return number(t_); }
    double corrected() const { return number(corrected_); }

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

    static std::vector<Entry> entries(const nb::list& listed) {
        std::vector<Entry> found;
        for (nb::handle one : listed)
            found.push_back(entry(nb::handle(one[0]).ptr(), nb::handle(one[1]).ptr(),
                                  nb::handle(one[2]).ptr()));
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

    // NaN where it is none.
    static double number(const Entry& entry) {
        PyObject* now = entry.now();
        if (!now || !PyFloat_Check(now)) return std::numeric_limits<double>::quiet_NaN();
        return PyFloat_AsDouble(now);
    }

    nb::object state_;
    nb::dict attributes_;
    nb::tuple held_;
    std::vector<Entry> same_, usual_;
    nb::object t_key_, corrected_key_;
    Entry t_, corrected_;
};

}  // namespace KERNEL_MODULE
