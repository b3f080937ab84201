// Calls the bound functions of fourd._native with arguments from a fuzzer's input (libFuzzer, `make fuzz-kernels`). The
// functions are called through Python, so that the checks of the bindings are part of the test. A call must return a
// result or raise a ValueError, a TypeError or a MemoryError, and no sanitizer may report an error.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "fuzz/arguments.h"
#include "fuzz/rules.h"
#include "fuzz/signature.h"

extern "C" PyObject* PyInit__native();

namespace {

namespace nb = nanobind;
using namespace fourd::fuzz;

constexpr int kMaxCalls = 3;
#if __has_feature(thread_sanitizer)
constexpr int kThreads = 3;  // Number of threads that call the same functions at the same time, each with its own
                             // arguments.
#else
constexpr int kThreads = 1;
#endif
// At its start, the program checks all rules for the sizes of arguments (rules.h). For each rule, it calls the function
// of the rule with random arguments until the function accepts them. kTries is the maximum number of these calls.
constexpr unsigned kTries = 20000;

struct Function {
    std::string name;
    nb::object callable, owner;  // If the function is a method, `owner` is its class.
    std::vector<Parameter> parameters;
    std::vector<Rules> rules;
};

struct State {
    std::vector<Function> functions;
    const Function* build_rays = nullptr;
    const Function* build_discs = nullptr;
};

// This object is never deleted, because the interpreter ends before the destructors of static objects run.
State* state = nullptr;

void add_functions(const nb::object& owner, const std::string& prefix, bool is_class) {
    for (nb::handle key : nb::object(owner.attr("__dict__")).attr("keys")()) {
        const std::string name = nb::cast<std::string>(nb::str(key));
        const nb::object value = owner.attr(name.c_str());
        if (nb::isinstance<nb::type_object>(value)) {
            add_functions(value, name + ".", true);
        } else if (nb::hasattr(value, "__nb_signature__") && name[0] != '_') {
            const nb::object overload = value.attr("__nb_signature__")[0];
            const std::string signature = nb::cast<std::string>(nb::str(nb::object(overload[0])));
            const nb::object docstring = overload[1];
            const std::string text = docstring.is_none() ? "" : nb::cast<std::string>(docstring);
            Function function{prefix + name, value, is_class ? owner : nb::none(), parse_signature(signature),
                              rules_of(text)};
            if (!function.parameters.empty()) state->functions.push_back(std::move(function));
        }
    }
}

// Calls a function. If an argument is the result of another function, calls that function first, with the same sizes.
nb::object call(const Function& function, const Rules& rules, Bytes& bytes, Sizes& sizes, int perturbed) {
    ArgumentMaker maker(bytes, sizes, rules, perturbed);
    nb::object tree;
    nb::list arguments;
    if (!function.owner.is_none()) arguments.append(function.owner());
    for (const Parameter& parameter : function.parameters) {
        // `nodes` and `blocks` are the arrays of a bounding volume hierarchy, whose contents the bindings do not check,
        // so valid hierarchies are built by build_rays and build_discs.
        const int part = parameter.name == "nodes" ? 0 : parameter.name == "blocks" ? 1 : -1;
        if (part >= 0) {
            const Function& build = function.name == "composite_discs" ? *state->build_discs : *state->build_rays;
            if (!tree.is_valid()) tree = call(build, build.rules[0], bytes, sizes, -1);
            arguments.append(tree[part]);
        } else {
            arguments.append(maker.make(parameter));
        }
    }
    return function.callable(*arguments);
}

// Returns true if the arguments were accepted.
bool try_call(const Function& function, const Rules& rules, Bytes& bytes) {
    try {
        Sizes sizes(bytes);
        const unsigned flags = bytes.byte();
        call(function, rules, bytes, sizes, flags >= 224 ? static_cast<int>(flags % 32) : -1);
        return true;
    } catch (const TooLarge&) {
    } catch (nb::python_error& error) {
        // Some calls must raise a TypeError, for example a call with a list of four numbers where three are expected.
        for (PyObject* expected : {PyExc_ValueError, PyExc_TypeError, PyExc_MemoryError}) {
            if (error.matches(expected)) return false;
        }
        std::fprintf(stderr, "%s: expected a result or a ValueError, got: %s\n", function.name.c_str(), error.what());
        std::abort();
    }
    return false;
}

// Finds outdated rules for argument sizes (rules.h). A rule is outdated if the function has changed so that every
// call with the rule fails.
void check_rules() {
    for (const Function& function : state->functions) {
        for (const Rules& rules : function.rules) {
            unsigned tries = 0;
            for (bool is_accepted = false; !is_accepted; ++tries) {
                if (tries == kTries) {
                    std::fprintf(stderr, "%s: expected arguments that the function accepts, got none in %u tries; correct "
                                 "the sizes in its docstring\n", function.name.c_str(), kTries);
                    std::exit(2);
                }
                Values values(tries);
                std::vector<std::uint8_t> content(512);
                for (std::uint8_t& byte : content) byte = static_cast<std::uint8_t>(values.bits());
                content[0] = 0;
                Bytes bytes(content.data(), content.size());
                is_accepted = try_call(function, rules, bytes);
            }
        }
    }
}

void call_functions(const std::uint8_t* data, std::size_t size) {
    Bytes bytes(data, size);
    for (int i = 0; i < kMaxCalls && !bytes.is_empty(); ++i) {
        const Function& function = state->functions[bytes.byte() % state->functions.size()];
        try_call(function, function.rules[bytes.byte() % function.rules.size()], bytes);
    }
}

void start_python() {
    PyImport_AppendInittab("_native", &PyInit__native);
    PyConfig config;
    PyConfig_InitPythonConfig(&config);
    config.install_signal_handlers = 0;
    PyConfig_SetBytesString(&config, &config.program_name, FUZZ_PYTHON);
    const PyStatus status = Py_InitializeFromConfig(&config);
    PyConfig_Clear(&config);
    if (PyStatus_Exception(status)) Py_ExitStatusException(status);
}

}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char***) {
    start_python();
    state = new State;
    add_functions(nb::module_::import_("_native"), "", false);
    for (const Function& function : state->functions) {
        if (function.name == "build_rays") state->build_rays = &function;
        if (function.name == "build_discs") state->build_discs = &function;
    }
    check_rules();
    std::fprintf(stderr, "%zu functions\n", state->functions.size());
    return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const nb::gil_scoped_release release;
    std::vector<std::thread> others;
    const auto call_with_lock = [=] {
        const nb::gil_scoped_acquire acquire;
        call_functions(data, size);
    };
    for (int i = 1; i < kThreads; ++i) others.emplace_back(call_with_lock);
    call_with_lock();
    for (std::thread& other : others) other.join();
    return 0;
}
