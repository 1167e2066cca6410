// law.step(state) as a method that is compiled whole: a frame of Python's, and what that reads of a law
// and a command, took a tenth of a tick on NAO.
#pragma once
#include <exception>

#include "deciding.hpp"

namespace KERNEL_MODULE {

// The engine of a law that steps without taking turns, or null, and whether the law says already that
// it has decided the last tick. Nothing is looked up again while the law's attributes stay as they are.
inline Engine* stepper(const nb::dict& law, bool& says) {
    static const nb::object key = nb::steal(PyUnicode_InternFromString("_stepper"));
    static const nb::object compiled = nb::steal(PyUnicode_InternFromString("compiled"));
    static const PyObject* type = nb::type<Engine>().ptr();
    static std::uint64_t version = 0;  // of no other dictionary
    static Engine* last = nullptr;
    const std::uint64_t now = version_of(law.ptr());
    says = now && now == version;
    if (says) return last;
    PyObject* found = PyDict_GetItem(law.ptr(), key.ptr());
    const bool is_engine = found && reinterpret_cast<PyObject*>(Py_TYPE(found)) == type;
    last = is_engine ? nb::inst_ptr<Engine>(found) : nullptr;
    says = PyDict_GetItem(law.ptr(), compiled.ptr()) == Py_True;
    version = says ? now : 0;
    return last;
}

// As coopqp.kernel.law says it, which goes on where the answer is not optimal.
inline PyObject* step(PyObject* self, PyObject* const* given, Py_ssize_t count, PyObject* named) {
    const bool is_named = named && count == 0 && PyTuple_Size(named) == 1 &&
                          PyUnicode_CompareWithASCIIString(PyTuple_GetItem(named, 0), "state") == 0;
    if (!is_named && (named || count != 1)) {
        PyErr_SetString(PyExc_TypeError, "step() takes one argument, the state");
        return nullptr;
    }
    PyObject* state = given[0];
    try {
        const nb::handle law = self;
        bool says;
        Engine* engine = stepper(attributes_of(law), says);
        if (!engine) return law.attr("_step_in_turn")(nb::handle(state)).release().ptr();
        const int outcome = engine->step(state);
        if (outcome) return law.attr("_stepped")(nb::handle(state), outcome).release().ptr();
        if (!says) law.attr("compiled") = true;
        return nb::object(engine->command()).release().ptr();
    } catch (nb::python_error& error) {
        error.restore();
    } catch (const std::exception& error) {
        PyErr_SetString(PyExc_RuntimeError, error.what());
    }
    return nullptr;
}

// Give a class of laws this method.
inline void give_step(nb::handle type) {
    static PyMethodDef method = {"step", reinterpret_cast<PyCFunction>(reinterpret_cast<void*>(step)),
                                 METH_FASTCALL | METH_KEYWORDS,
                                 "A tick and state.advance in one; by the kernel alone where possible."};
    nb::setattr(type, "step",
                nb::steal(PyDescr_NewMethod(reinterpret_cast<PyTypeObject*>(type.ptr()), &method)));
}

}  // namespace KERNEL_MODULE
