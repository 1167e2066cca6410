// What Python sees of the kernel.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include "deciding.hpp"
#include "following.hpp"
#include "free_space.hpp"
#include "online.hpp"
#include "planning.hpp"
#include "sliding.hpp"
#include "stepping.hpp"
#include "trajectory_evaluation.hpp"

using namespace nb::literals;

using KERNEL_MODULE::Columns;
using KERNEL_MODULE::Engine;
using KERNEL_MODULE::Following;
using KERNEL_MODULE::FreeSpace;
using KERNEL_MODULE::Reading;
using KERNEL_MODULE::Ring;
using KERNEL_MODULE::Samples;
using KERNEL_MODULE::Planner;
using KERNEL_MODULE::Slide;
using KERNEL_MODULE::TrajectoryEvaluation;
using KERNEL_MODULE::Written;
using Joints = std::vector<std::size_t>;

// An engine holds a state and a command, which may tell of the law that holds the engine.
int visit_engine(PyObject* self, visitproc visit, void* arg) {
    Py_VISIT(Py_TYPE(self));
    return nb::inst_ready(self) ? nb::inst_ptr<Engine>(self)->visit(visit, arg) : 0;
}
int clear_engine(PyObject* self) {
    nb::inst_ptr<Engine>(self)->let_go();
    return 0;
}
PyType_Slot of_engine[] = {{Py_tp_traverse, reinterpret_cast<void*>(visit_engine)},
                           {Py_tp_clear, reinterpret_cast<void*>(clear_engine)},
                           {0, nullptr}};

NB_MODULE(KERNEL_MODULE, m) {
    nb::set_leak_warnings(false);  // what a script holds to its end is no leak of ours
    nb::class_<Engine>(m, "Engine", nb::type_slots(of_engine))
        .def(nb::init<const nb::dict&>())
        .def("bind_state", &Engine::bind_state)
        .def("bind_owner", &Engine::bind_owner)
        .def("let_go", &Engine::let_go)
        .def("is_bound", &Engine::is_bound)
        .def("bind_limits", &Engine::bind_limits)
        .def("bind_measured", &Engine::bind_measured)
        .def("bind_rows", &Engine::bind_rows)
        .def("bind_reference", &Engine::bind_reference)
        .def("tick", &Engine::tick)
        .def("bind_reading", &Engine::bind_reading)
        .def("bind_observer", &Engine::bind_observer)
        .def("tick_measured", &Engine::tick_measured)
        .def("forget_measured", &Engine::forget_measured)
        .def("place", &Engine::place)
        .def("tick_with_rows", &Engine::tick_with_rows)
        .def("rest", &Engine::rest)
        .def("run_starts", &Engine::run_starts)
        .def("resolve", &Engine::resolve)
        .def("run", &Engine::run, "t"_a, "q"_a, "v"_a, "said"_a, "scale"_a, "memory"_a,
             "remembered"_a, "stops"_a, "all_corrected"_a)
        .def("step", &Engine::step)
        .def_static("give_step", &KERNEL_MODULE::give_step)
        .def("scale", &Engine::scale)
        .def("unlocks", &Engine::unlocks)
        .def("rows", &Engine::rows)
        .def("near", &Engine::near)
        .def("worst", &Engine::worst);
    nb::class_<FreeSpace>(m, "FreeSpace")
        .def(nb::init<const nb::dict&>())
        .def("is_free", &FreeSpace::is_free)
        .def("measure", &FreeSpace::measure);
    nb::class_<Following>(m, "Following")
        .def(nb::init<Engine&, Engine&, Engine&, const FreeSpace&, const nb::dict&>(),
             nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>(),
             nb::keep_alive<1, 5>())
        .def("take_hold", &Following::take_hold)
        .def("follow", &Following::follow);
    nb::class_<Reading>(m, "Reading")
        .def(nb::init<const Written&, const Joints&, const std::vector<double>&, double>())
        .def("take", &Reading::take);
    nb::class_<Columns>(m, "Columns")
        .def(nb::init<const Written&, const Joints&, const Joints&, std::size_t>(),
             "table"_a.noconvert(), "first"_a, "sizes"_a, "open"_a)
        .def("add", &Columns::add);
    nb::class_<Ring>(m, "Ring").def(nb::init<const nb::dict&>()).def("add", &Ring::add);
    nb::class_<Samples>(m, "Samples")
        .def(nb::init<const Written&, const Written&, const Joints&, const std::vector<Joints>&, int,
                      int, const std::vector<int>&, int, const std::vector<double>&, double, int,
                      double, double>())
        .def("add", &Samples::add)
        .def("forget", &Samples::forget)
        .def("trust", &Samples::trust)
        .def_prop_ro("readings", &Samples::readings)
        .def_prop_ro("leapt", &Samples::leapt)
        .def("quiet", &Samples::quiet)
        .def("stands", &Samples::stands)
        .def("whiten", &Samples::whiten);
    nb::class_<Planner>(m, "Planner")
        .def(nb::init<const nb::dict&>())
        .def("project", &Planner::project)
        .def("is_free", &Planner::is_free)
        .def("find", &Planner::find, "search"_a, "others"_a.none(), "wait"_a);
    nb::class_<Slide>(m, "Slide")
        .def(nb::init<const nb::dict&>())
        .def("step", &Slide::step);
    nb::class_<TrajectoryEvaluation>(m, "TrajectoryEvaluation")
        .def(nb::init<const nb::dict&>())
        .def("look", &TrajectoryEvaluation::look);
    m.attr("sources") = KERNEL_SOURCES;  // coopqp.kernel.native.digest
    m.def("has_avx2", [] {
#if defined(__x86_64__) || defined(__i386__)
        return bool(__builtin_cpu_supports("avx2"));
#else
        return false;
#endif
    });
}
