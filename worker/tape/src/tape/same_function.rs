//! Compares two recordings of one function, up to the numbers of their values: a check of tests.

use std::collections::HashMap;

use super::{Function, Operation, Statement, Tape, ValueId};

/// Whether two functions of a tape compute the same from the same uniforms.
pub(super) fn is_same(tape: &Tape, first: &Function, second: &Function) -> bool {
    Comparison { tape, pairs: HashMap::new() }.functions(first, second)
}

struct Comparison<'a> {
    tape: &'a Tape,
    /// Value of the second function for each value of the first.
    pairs: HashMap<ValueId, ValueId>,
}

impl Comparison<'_> {
    fn functions(&mut self, first: &Function, second: &Function) -> bool {
        first.row_words == second.row_words
            && self.values(&first.arguments, &second.arguments)
            && self.blocks(&first.body, &second.body)
            && self.values(&first.results, &second.results)
    }

    fn blocks(&mut self, first: &[Statement], second: &[Statement]) -> bool {
        first.len() == second.len() && first.iter().zip(second).all(|(a, b)| self.statements(a, b))
    }

    fn values(&mut self, first: &[ValueId], second: &[ValueId]) -> bool {
        first.len() == second.len() && first.iter().zip(second).all(|(&a, &b)| self.value(a, b))
    }

    fn value(&mut self, first: ValueId, second: ValueId) -> bool {
        if let Some(&known) = self.pairs.get(&first) {
            return known == second;
        }
        self.pairs.insert(first, second);
        let (a, b) = (self.tape.definition(first), self.tape.definition(second));
        let is_same_operation = match (a.operation, b.operation) {
            (Operation::Uniform(a), Operation::Uniform(b)) => {
                self.tape.uniforms[a as usize] == self.tape.uniforms[b as usize]
            }
            (a, b) => a == b,
        };
        let mut operands = a.operands.into_iter().zip(b.operands);
        is_same_operation
            && a.kind == b.kind
            && operands.all(|pair| match pair {
                (Some(a), Some(b)) => self.value(a, b),
                (a, b) => a == b,
            })
    }

    fn statements(&mut self, first: &Statement, second: &Statement) -> bool {
        use Statement::{Call, Comment, Emit, Fold, Repeat, When};
        match (first, second) {
            (Emit(a), Emit(b)) => self.value(*a, *b),
            (Comment(a), Comment(b)) => a == b,
            (Call { function: f, arguments: p, returned: r }, Call { function: g, arguments: q, returned: s }) => {
                f == g && self.values(p, q) && self.values(r, s)
            }
            (
                When { condition: c, variables: v, otherwise: o, body: b, value: r },
                When { condition: d, variables: w, otherwise: p, body: e, value: s },
            ) => self.value(*c, *d) && self.values(o, p) && self.blocks(b, e) && self.values(r, s) && self.values(v, w),
            (
                Repeat { limit: l, pauses: m, variables: v, start: t, body: b, next: n, again: a },
                Repeat { limit: k, pauses: o, variables: w, start: u, body: e, next: p, again: c },
            ) => {
                (l, m) == (k, o)
                    && self.values(t, u)
                    && self.values(v, w)
                    && self.blocks(b, e)
                    && self.values(n, p)
                    && self.value(*a, *c)
            }
            (Fold(a), Fold(b)) => {
                let tape = self.tape;
                a.depth == b.depth
                    && a.leaves.len() == b.leaves.len()
                    && a.joins.len() == b.joins.len()
                    && self.values(&[a.list, a.last], &[b.list, b.last])
                    && self.values(&a.arguments, &b.arguments)
                    && a.functions()
                        .zip(b.functions())
                        .all(|(f, g)| self.functions(&tape.functions[f], &tape.functions[g]))
                    && self.values(&a.returned, &b.returned)
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use scene::Integrator;
    use scene::cells::ScalarBuilder;
    use scene::real::{FunctionKey, Real};

    use super::super::{Expr, Tape, record, record_and_compare};
    use crate::picture_tape::{accumulate, finish, record_entries};

    /// A tape with two calls by one key.
    fn called_twice(first: impl FnOnce(Expr) -> Expr, second: impl FnOnce(Expr) -> Expr) -> Tape {
        let key = FunctionKey::new("step");
        record_and_compare(|recording| {
            recording.entry("main", |[a, b]: [Expr; 2]| vec![a.call(key, a, first) + b.call(key, b, second)]);
        })
    }

    #[test]
    fn calls_by_one_key_share_a_function() {
        let body = |x: Expr| Expr::repeat(3, x, |x| (x.below(9.0), x.mul_add(x, x.uniform(0.5)))) + 1.0;
        let tape = called_twice(body, body);
        assert_eq!((tape.functions.len(), tape.uniforms()), (2, [0.5_f32.to_bits()].as_slice()));
        assert!(tape.verify().is_ok());
    }

    #[test]
    #[should_panic(expected = "has two bodies")]
    fn a_key_with_two_bodies_is_refused() {
        called_twice(|x| x + 1.0, |x| x + 2.0);
    }

    #[test]
    #[should_panic(expected = "has two bodies")]
    fn a_key_with_numbers_of_two_objects_is_refused() {
        called_twice(|x| x + x.uniform(1.0), |x| x + x.uniform(2.0));
    }

    #[test]
    fn a_name_with_two_keys_is_refused() {
        let tape = record(|recording| {
            recording.entry("main", |[a, b]: [Expr; 2]| {
                let first = a.call(FunctionKey::new("step"), a, |a| a + 1.0);
                vec![first + b.call(FunctionKey::new("step"), b, |b| b + 2.0)]
            });
        });
        assert!(tape.verify().is_err());
    }

    #[test]
    fn every_key_of_a_shipped_scene_has_one_body() {
        let (mut once, mut compared) = (Duration::ZERO, Duration::ZERO);
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes");
        for entry in std::fs::read_dir(folder).expect("the scenes are there") {
            let path = entry.expect("a folder can be read").path();
            if path.extension().is_some_and(|extension| extension == "json") {
                let job = scene::parse(&std::fs::read(&path).expect("a job file")).expect("a valid job");
                let at_frame = job.at(0).expect("a valid frame");
                let program = Integrator::of_picture(&at_frame, &ScalarBuilder);
                let start = Instant::now();
                let tape = record_entries(&program, &at_frame);
                once += start.elapsed();
                let start = Instant::now();
                let again = record_and_compare(|recording| {
                    accumulate(recording, &program, at_frame.image());
                    finish(recording, &program, at_frame.image());
                });
                compared += start.elapsed();
                assert!(tape.uniforms == again.uniforms, "{}", path.display());
                assert!(tape.instructions == again.instructions, "{}", path.display());
            }
        }
        println!("recorded in {once:?}, with comparisons in {compared:?}");
    }
}
