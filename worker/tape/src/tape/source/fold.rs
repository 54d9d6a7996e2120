//! Source of folds of lists: a loop over the operations, with the values that wait in variables.

use math::real::list::{NO_LEAF, OPERATION_WORDS, ROW_BITS, ROW_MASK};

use super::Printer;
use crate::tape::{Fold, ValueType};

impl Printer<'_> {
    pub(super) fn fold(&mut self, depth: usize, fold: &Fold) {
        let width = fold.returned.len();
        let number = self.names.len();
        let name = |part: &str, place: usize| format!("{part}{number}_{place}");
        let all = |part: &str| (0..width).map(|place| name(part, place)).collect::<Vec<_>>();
        let (below, value) = (all("below"), all("value"));
        // The first of them waits last.
        let waiting: Vec<Vec<String>> = (0..fold.depth).map(|index| all(&format!("waiting{index}_"))).collect();
        for name in below.iter().chain(&value).chain(waiting.iter().flatten()) {
            self.line(depth, &self.language.variable(ValueType::F32, name, "0.0f"));
        }
        for (&id, name) in fold.returned.iter().zip(&below) {
            self.names.insert(id, name.clone());
        }
        let (list, last) = (self.operand(fold.list), self.operand(fold.last));
        let arguments: Vec<String> = fold.arguments.iter().map(|&id| self.operand(id)).collect();
        self.line(depth, &self.language.list_loop(&list, OPERATION_WORDS));
        let inner = depth + 1;
        for (name, word) in [
            ("leaf", format!("word_at(at, {last})")),
            ("join", format!("word_at(at + 1u, {last})")),
            ("leaf_function", format!("(leaf >> {ROW_BITS}u) & {NO_LEAF}u")),
            ("join_function", format!("(join >> {ROW_BITS}u) & {NO_LEAF}u")),
        ] {
            self.line(inner, &self.language.constant(ValueType::U32, name, &word));
        }
        self.line(inner, &format!("if (leaf_function != {NO_LEAF}u) {{"));
        self.line(inner + 1, "if (join_function == 0u) {");
        for index in (0..waiting.len()).rev() {
            let from = if index == 0 { &below } else { &waiting[index - 1] };
            self.copy(inner + 2, &waiting[index], from);
        }
        self.line(inner + 1, "}");
        self.cases(inner + 1, "leaf_function", "leaf", &fold.leaves, 0, &arguments, &value);
        self.line(inner, "} else {");
        self.copy(inner + 1, &value, &below);
        self.line(inner + 1, "if ((join >> 31u) == 0u) {");
        for (index, from) in waiting.iter().enumerate() {
            let to = if index == 0 { &below } else { &waiting[index - 1] };
            self.copy(inner + 2, to, from);
        }
        self.line(inner + 1, "}");
        self.line(inner, "}");
        self.line(inner, "if (join_function == 0u) {");
        self.copy(inner + 1, &below, &value);
        self.line(inner, "} else {");
        let arguments: Vec<String> = below.iter().chain(&value).cloned().collect();
        self.cases(inner + 1, "join_function", "join", &fold.joins, 1, &arguments, &below);
        self.line(inner, "}");
        self.line(inner, &self.language.break_if(&format!("(leaf >> 31u) != 0u || at >= {last}")));
        self.line(depth, "}");
    }

    fn copy(&mut self, depth: usize, to: &[String], from: &[String]) {
        for (to, from) in to.iter().zip(from) {
            self.line(depth, &format!("{to} = {from};"));
        }
    }

    /// Calls the function whose number, from `first`, is in a variable.
    #[expect(clippy::too_many_arguments, reason = "parts of one call")]
    fn cases(
        &mut self,
        depth: usize,
        chosen: &str,
        word: &str,
        functions: &[usize],
        first: usize,
        arguments: &[String],
        results: &[String],
    ) {
        let arguments = arguments.join(", ");
        for (index, &function) in functions.iter().enumerate() {
            let name = self.tape.functions[function].name;
            // The last needs no question: a list of the scene names no other.
            if functions.len() > 1 {
                self.line(depth, &format!("if ({chosen} == {}u) {{", index + first));
            } else {
                self.line(depth, "{");
            }
            let call = format!("step_{name}({word} & {ROW_MASK}u, {arguments})");
            self.line(depth + 1, &self.language.result(name, "r", &call));
            for (place, result) in results.iter().enumerate() {
                self.line(depth + 1, &format!("{result} = r.f{place};"));
            }
            self.line(depth, "}");
        }
    }
}
