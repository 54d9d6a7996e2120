//! Places of a function's variables: a linear scan over their lifetimes (Poletto and Sarkar, "Linear Scan Register
//! Allocation", TOPLAS 21(5), 1999). A variable that is used rarely for its length, or that lives across a call, lies
//! in the thread's frame.

use crate::interrupt;

use super::linear::{Class, Linear, Origin, Step, Var};

/// Where a variable is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Location {
    /// Vector register.
    Vector(u8),
    /// Mask register.
    Mask(u8),
    /// Slot of the function's part of the frame, by its index.
    Slot(u32),
    /// Argument of the function, in the frame.
    Argument(u32),
    /// The function's mask of active lanes, in the frame.
    Live,
    /// Constant, by its bits.
    Constant(u32),
    /// Uniform, by its index.
    Uniform(u32),
    /// Word of the function's row, by its index.
    Row(u32),
    /// Never used.
    Nowhere,
}

/// Places of all variables of a function.
#[derive(Debug)]
pub(crate) struct Allocation {
    pub(crate) places: Vec<Location>,
    /// Number of slots.
    pub(crate) slots: u32,
}

#[derive(Clone, Copy, Debug)]
struct Interval {
    var: Var,
    start: u32,
    end: u32,
    weight: f32,
}

/// Lifetimes of all variables, and the positions of calls.
fn intervals(linear: &Linear) -> (Vec<Interval>, Vec<u32>) {
    let count = linear.variables.len();
    let mut all: Vec<Interval> =
        (0..count).map(|var| Interval { var: var as Var, start: u32::MAX, end: 0, weight: 0.0 }).collect();
    let mut touch = |var: Var, at: u32, weight: f32| {
        let interval = &mut all[var as usize];
        interval.start = interval.start.min(at);
        interval.end = interval.end.max(at);
        interval.weight += weight;
    };
    for &var in linear.arguments.iter().chain([&linear.live]) {
        touch(var, 0, 1.0);
    }
    let (mut calls, mut open, mut loops) = (Vec::new(), Vec::new(), Vec::new());
    for (index, step) in linear.steps.iter().enumerate() {
        let at = index as u32 + 1;
        // A loop is taken to run eight times.
        let weight = (1_u64 << (3 * open.len().min(16))) as f32;
        step.for_each_var(|var| touch(var, at, weight));
        match step {
            step if step.is_call() => calls.push(at),
            Step::Top(_) => open.push(at),
            Step::RepeatWhileAny { .. } => loops.push((open.pop().expect("a loop begins"), at)),
            _ => {}
        }
    }
    let end = linear.steps.len() as u32 + 1;
    for &var in &linear.results {
        touch(var, end, 1.0);
    }
    // A variable from before a loop that the loop uses lives to the loop's end; inner loops come first.
    for (top, end) in loops {
        interrupt::check();
        for step in &linear.steps[top as usize - 1..end as usize] {
            step.for_each_var(|var| {
                let interval = &mut all[var as usize];
                if interval.start < top {
                    interval.end = interval.end.max(end);
                }
            });
        }
    }
    (all, calls)
}

/// State of the registers of one class.
struct ClassState {
    free: Vec<u8>,
    /// Occupied ones, with their variables.
    active: Vec<(Interval, u8)>,
}

impl ClassState {
    fn expire(&mut self, at: u32) {
        let free = &mut self.free;
        self.active.retain(|(interval, register)| {
            let lives = interval.end > at;
            if !lives {
                free.push(*register);
            }
            lives
        });
    }
}

/// Numbers of registers for variables.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Registers {
    /// Vector registers, from 0.
    pub(crate) vectors: u8,
    /// Mask registers, from 1; without any, masks are vectors.
    pub(crate) masks: u8,
}

/// Chooses places among these registers.
pub(crate) fn allocate(linear: &Linear, registers: Registers) -> Allocation {
    let (mut intervals, calls) = intervals(linear);
    let mut places = vec![Location::Nowhere; linear.variables.len()];
    intervals.retain(|interval| match linear.variables[interval.var as usize].source {
        Origin::Constant(bits) => {
            places[interval.var as usize] = Location::Constant(bits);
            false
        }
        Origin::Uniform(index) => {
            places[interval.var as usize] = Location::Uniform(index);
            false
        }
        Origin::Row(index) => {
            places[interval.var as usize] = Location::Row(index);
            false
        }
        Origin::Step => interval.start != u32::MAX,
    });
    intervals.sort_by_key(|interval| (interval.start, interval.var));
    let mut vector = ClassState { free: (0..registers.vectors).rev().collect(), active: Vec::new() };
    // k0 can't be a mask.
    let mut mask = ClassState { free: (1..=registers.masks).rev().collect(), active: Vec::new() };
    let mut spilled = Vec::new();
    for &interval in &intervals {
        interrupt::check();
        let crosses_call = {
            let next = calls.partition_point(|&call| call <= interval.start);
            calls.get(next).is_some_and(|&call| call < interval.end)
        };
        if crosses_call {
            spilled.push(interval);
            continue;
        }
        let is_mask = registers.masks > 0 && linear.variables[interval.var as usize].class == Class::Mask;
        let state = if is_mask { &mut mask } else { &mut vector };
        let place = |register| if is_mask { Location::Mask(register) } else { Location::Vector(register) };
        state.expire(interval.start);
        if let Some(register) = state.free.pop() {
            places[interval.var as usize] = place(register);
            state.active.push((interval, register));
            continue;
        }
        let density = |interval: &Interval| interval.weight / (interval.end - interval.start + 1) as f32;
        let (least, _) = state
            .active
            .iter()
            .enumerate()
            .min_by(|(_, (a, _)), (_, (b, _))| density(a).total_cmp(&density(b)))
            .unzip();
        let Some(least) = least else {
            spilled.push(interval);
            continue;
        };
        if density(&state.active[least].0) < density(&interval) {
            let (victim, register) = std::mem::replace(&mut state.active[least], (interval, 0));
            state.active[least].1 = register;
            places[interval.var as usize] = place(register);
            spilled.push(victim);
        } else {
            spilled.push(interval);
        }
    }
    let slots = slots(linear, spilled, &mut places);
    Allocation { places, slots }
}

/// Gives slots to variables without registers; arguments stay where their callers put them.
fn slots(linear: &Linear, mut spilled: Vec<Interval>, places: &mut [Location]) -> u32 {
    spilled.sort_by_key(|interval| (interval.start, interval.var));
    let (mut free, mut active, mut count): (Vec<u32>, Vec<(u32, u32)>, u32) = (Vec::new(), Vec::new(), 0);
    for interval in spilled {
        interrupt::check();
        let place = &mut places[interval.var as usize];
        if interval.var == linear.live {
            *place = Location::Live;
        } else if let Some(index) = linear.arguments.iter().position(|&var| var == interval.var) {
            *place = Location::Argument(index as u32);
        } else {
            active.retain(|&(end, slot)| {
                if end < interval.start {
                    free.push(slot);
                }
                end >= interval.start
            });
            let slot = free.pop().unwrap_or_else(|| {
                count += 1;
                count - 1
            });
            active.push((interval.end, slot));
            *place = Location::Slot(slot);
        }
    }
    count
}
