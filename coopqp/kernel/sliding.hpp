// Motions along the loops as a Python class.
#pragma once
#include <memory>

#include "core/slide.hpp"
#include "reading.hpp"

namespace KERNEL_MODULE {

class Slide {
  public:
    explicit Slide(const nb::dict& d) {
        auto arena = std::make_unique<coopqp::Arena>();
        auto model = model_of(nb::cast<nb::dict>(d["model"]), *arena);
        slide_ = std::make_unique<coopqp::Slide>(std::move(arena), std::move(model),
                                                 kept_of(numbers(d, "kept")));
    }

    // With the GIL held, which keeps other threads out.
    double step(const Written& q, const Numbers& direction, double size, int newton) {
        const auto n = std::size_t(slide_->n());
        if (q.size() != n || direction.size() != n) throw nb::value_error("a number for each joint");
        return slide_->step(q.data(), direction.data(), size, newton);
    }

  private:
    std::unique_ptr<coopqp::Slide> slide_;
};

}  // namespace KERNEL_MODULE
