// Parses the parameters of a bound function from the signature that nanobind stores.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

namespace fourd::fuzz {

enum class Kind { array, arrays, number, numbers, integer, integers, flag, text, object };

struct Parameter {
    std::string name, dtype;  // The dtype of arrays is NumPy's name, such as "float32".
    Kind kind;
    bool is_optional;
    std::vector<long> shape;  // -1 for an axis of any size.
};

inline std::string between(const std::string& text, const std::string& before, const std::string& after) {
    const std::size_t begin = text.find(before);
    if (begin == std::string::npos) return "";
    const std::size_t from = begin + before.size();
    return text.substr(from, text.find(after, from) - from);
}

inline std::vector<std::string> split(const std::string& text, char separator) {
    std::vector<std::string> parts(1);
    int depth = 0;
    for (const char letter : text) {
        depth += letter == '[' || letter == '(' ? 1 : letter == ']' || letter == ')' ? -1 : 0;
        if (letter == separator && depth == 0) {
            parts.emplace_back();
        } else if (letter != ' ' || !parts.back().empty()) {
            parts.back() += letter;
        }
    }
    if (parts.back().empty()) parts.pop_back();
    return parts;
}

inline Parameter parse_parameter(const std::string& name, std::string type) {
    constexpr const char* kSequence = "collections.abc.Sequence[";
    Parameter out{name, "", Kind::object, false, {}};
    const std::size_t none = type.find(" | None");
    if (none != std::string::npos) out.is_optional = true, type.resize(none);
    const bool is_list = type.rfind(kSequence, 0) == 0;
    if (is_list) type = type.substr(std::string(kSequence).size(), type.size() - std::string(kSequence).size() - 1);
    if (type.rfind("ndarray[", 0) == 0) {
        out.kind = is_list ? Kind::arrays : Kind::array;
        out.dtype = between(type, "dtype=", ",");
        for (const std::string& side : split(between(type, "shape=(", ")"), ',')) {
            out.shape.push_back(side == "*" ? -1 : std::stol(side));
        }
    } else if (type == "float") {
        out.kind = is_list ? Kind::numbers : Kind::number;
    } else if (type == "int") {
        out.kind = is_list ? Kind::integers : Kind::integer;
    } else if (type == "bool") {
        out.kind = Kind::flag;
    } else if (type == "str") {
        out.kind = Kind::text;
    }
    return out;
}

// Parses "def name(a: type, b: type) -> type". The result does not contain the parameter `self`, which has no type.
inline std::vector<Parameter> parse_signature(const std::string& signature) {
    const std::size_t begin = signature.find('(') + 1, end = signature.rfind(") ->");
    std::vector<Parameter> out;
    for (const std::string& part : split(signature.substr(begin, end - begin), ',')) {
        const std::size_t colon = part.find(": ");
        if (colon != std::string::npos) out.push_back(parse_parameter(part.substr(0, colon), part.substr(colon + 2)));
    }
    return out;
}

}  // namespace fourd::fuzz
