// The state that a kernel's arrays belong to, and whether Python has put others in their place. To ask
// for this here, by dictionary, takes a third of the time that it takes in Python.
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
          t_(interned("t")), corrected_(interned("corrected")) {}

    bool is(nb::handle state) const { return state.is(state_) && hold(same_); }
    bool is_usual() const { return hold(usual_); }
    double t() const { return number(t_); }
    double corrected() const { return number(corrected_); }

  private:
    struct Entry {
        PyObject *of, *key, *value;
    };

    static std::vector<Entry> entries(const nb::list& listed) {
        std::vector<Entry> found;
        for (nb::handle one : listed)
            found.push_back({nb::handle(one[0]).ptr(), nb::handle(one[1]).ptr(),
                             nb::handle(one[2]).ptr()});
        return found;
    }

    static nb::object interned(const char* name) {
        return nb::steal(PyUnicode_InternFromString(name));
    }

    static bool hold(const std::vector<Entry>& entries) {
        for (const Entry& entry : entries) {
            PyObject* now = PyDict_GetItem(entry.of, entry.key);
            if ((now ? now : Py_None) != entry.value) return false;
        }
        return true;
    }

    // NaN where it is none.
    double number(const nb::object& key) const {
        PyObject* now = PyDict_GetItem(attributes_.ptr(), key.ptr());
        if (!now || !PyFloat_Check(now)) return std::numeric_limits<double>::quiet_NaN();
        return PyFloat_AsDouble(now);
    }

    nb::object state_;
    nb::dict attributes_;
    nb::tuple held_;
    std::vector<Entry> same_, usual_;
    nb::object t_, corrected_;
};

}  // namespace KERNEL_MODULE
