// Parses the rules for the sizes of a bound function's arguments, and chooses sizes that obey them for one call. A
// fuzzer needs the rules because few combinations of random sizes would be valid.
//
// The docstring of every bound function with array arguments contains a line `Sizes: RULE RULE ...`. A function that
// accepts several combinations of sizes has one such line for each of them.
//
// A rule NAME=A,B gives the sizes of the free axes (axes that may have any size) of the array NAME, or the value of the
// integer argument NAME. NAME*L gives the length L of a list. NAME*L=A,B gives the length, and the sizes of the arrays
// in the list. NAME<N limits the values of an int32 array to the range from 0 to N - 1. A capital letter stands for the
// same size everywhere in one call. 2AB is a product, and A+B is a sum. A> stands for a different size in each array of
// a list: A in the first array, A / 2 in the second, A / 4 in the third, and so on. These sizes are rounded down, and a
// size of 0 is replaced by 1. Sizes without a rule are chosen independently.
#pragma once

#include <algorithm>
#include <cctype>
#include <map>
#include <string>
#include <vector>

#include "fuzz/bytes.h"
#include "fuzz/signature.h"

namespace fourd::fuzz {

struct Rule {
    std::vector<std::string> axes;  // Expressions for the sizes of the free axes. Empty if no rule gives these sizes.
    std::string length, limit;      // Expressions for the length of a list and for the limit of int32 values, or empty.
};

using Rules = std::map<std::string, Rule>;

inline Rules parse_rules(const std::string& text) {
    Rules out;
    for (const std::string& part : split(text, ' ')) {
        if (part.empty()) continue;
        const std::size_t end = part.find_first_of("=*<");
        Rule& rule = out[part.substr(0, end)];
        const std::size_t equals = part.find('=');
        if (part[end] == '<') rule.limit = part.substr(end + 1);
        if (part[end] == '*') rule.length = part.substr(end + 1, equals - end - 1);
        if (equals != std::string::npos) rule.axes = split(part.substr(equals + 1), ',');
    }
    return out;
}

// Parses all lines `Sizes: ...` of a docstring. The result has one element for each of these lines. Without such a
// line, the result has one element without rules.
inline std::vector<Rules> rules_of(const std::string& docstring) {
    constexpr const char* kStart = "Sizes:";
    std::vector<Rules> out;
    for (const std::string& line : split(docstring, '\n')) {
        if (line.rfind(kStart, 0) == 0) out.push_back(parse_rules(line.substr(std::string(kStart).size())));
    }
    if (out.empty()) out.emplace_back();
    return out;
}

// The sizes of one call, keyed by the letters in the rules. A size is read from the fuzzer's input when it is first
// used.
class Sizes {
  public:
    explicit Sizes(Bytes& bytes) : bytes_(bytes) {}

    std::size_t of(char letter) {
        const auto [place, is_new] = sizes_.try_emplace(letter, 0);
        if (is_new) place->second = bytes_.size();
        return place->second;
    }

    // The expression A> halves the size A `halvings` times: once for each array that precedes this array in its list.
    std::size_t evaluate(const std::string& expression, std::size_t halvings) {
        std::size_t sum = 0, product = 1, number = 0;
        for (std::size_t i = 0; i < expression.size(); ++i) {
            const char letter = expression[i];
            if (std::isdigit(static_cast<unsigned char>(letter))) {
                number = 10 * number + static_cast<std::size_t>(letter - '0');
                if (i + 1 == expression.size() || !std::isdigit(static_cast<unsigned char>(expression[i + 1]))) {
                    product *= number, number = 0;
                }
            } else if (letter == '+') {
                sum += product, product = 1;
            } else if (letter != '>') {
                const bool is_halved = i + 1 < expression.size() && expression[i + 1] == '>';
                const std::size_t size = of(letter);
                product *= is_halved ? std::max<std::size_t>(1, size >> std::min<std::size_t>(halvings, 32)) : size;
            }
        }
        return sum + product;
    }

  private:
    Bytes& bytes_;
    std::map<char, std::size_t> sizes_;
};

}  // namespace fourd::fuzz
