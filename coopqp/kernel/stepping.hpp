// law.step(state) as a method that is compiled whole: a frame of Python's, and what that reads of a law
// and a command, took a tenth of a tick on NAO.
#pragma once
#include "deciding.hpp"

namespace KERNEL_MODULE {

// The engine of a law that steps without taking turns, or null.
inline Engine* stepper(const nb::dict& law) {
    static const nb::object key = nb::steal(PyUnicode_InternFromString("_stepper"));
    static const PyObject* type = nb::type<Engine>().ptr();
    PyObject* found = PyDict_GetItem(law.ptr(), key.ptr());
    const bool is_engine = found && reinterpret_cast<PyObject*>(Py_TYPE(found)) == type;
    return is_engine ? nb::inst_ptr<Engine>(found) : nullptr;
}

// As coopqp.kernel.law says it, which goes on where the answer is not optimal.
inline PyObject* step(PyObject* self, PyObject* state) {
    static const nb::object compiled = nb::steal(PyUnicode_InternFromString("compiled"));
    try {
        const nb::handle law = self;
        const nb::dict attributes = attributes_of(law);
        Engine* engine = stepper(attributes);
        if (!engine) return law.attr("_step_in_turn")(nb::handle(state)).release().ptr();
        const int outcome = engine->step(state);
        if (outcome) return law.attr("_stepped")(nb::handle(state), outcome).release().ptr();
        if (PyDict_GetItem(attributes.ptr(), compiled.ptr()) != Py_True)
            law.attr("compiled") = true;
        return nb::object(engine->command()).release().ptr();
    } catch (nb::python_error& error) {
        error.restore();
        return nullptr;
    }
}

// Give a class of laws this method.
inline void give_step(nb::handle type) {
    static PyMethodDef method = {"step", step, METH_O,
                                 "A tick and state.advance in one; by the kernel alone where possible."};
    nb::setattr(type, "step",
                nb::steal(PyDescr_NewMethod(reinterpret_cast<PyTypeObject*>(type.ptr()), &method)));
}

}  // namespace KERNEL_MODULE
