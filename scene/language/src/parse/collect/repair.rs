//! Repairs of an invalid value: replaces as little as possible by something valid.

use super::{Collector, DocumentPart, steps};
use crate::parse::form::{FormError, FormErrorKind};
use crate::parse::stand_ins::VALUES;
use crate::parse::tree::{Body, Member, Value};

/// Lists whose entries are compared with the previous entry: a stand-in for one entry would invalidate the next.
const ORDERED: [&str; 2] = ["keys", "ramp"];

impl Collector<'_> {
    /// Reports an error of a part, and repairs the part so that it has another error, or none.
    pub(super) fn repair(&mut self, part: DocumentPart, place: &[usize], fault: &FormError) {
        let fault_steps = steps(&fault.pointer);
        let value = self.root.at(place);
        let (below, _) = value.map(|value| value.path_of(&fault_steps)).unwrap_or_default();
        let mut target = [place, &below].concat();
        let is_known = match &fault.kind {
            FormErrorKind::MissingKey(key) => self.removed(&target, key).is_some() || self.may_be_misnamed(&target),
            FormErrorKind::UnknownKey(_) | FormErrorKind::UnknownName(_) | FormErrorKind::Value => false,
        };
        let is_theirs = self.root.at(&target).is_some_and(|value| !matches!(value.body, Body::StandIn(_)));
        if !is_known && (is_theirs || fault.is_key) {
            self.tell(&target, fault);
        }
        let is_mended = match &fault.kind {
            FormErrorKind::UnknownKey(meant) => {
                if self.rename(part, place, &target, meant.as_deref()) {
                    self.note_repair(&target);
                } else {
                    self.remove(&target);
                }
                true
            }
            FormErrorKind::UnknownName(meant) if fault.is_key => {
                let is_renamed = self.rename(part, place, &target, meant.as_deref());
                if !is_renamed && target.len() > place.len() {
                    target.pop();
                }
                is_renamed
            }
            FormErrorKind::MissingKey(key) => self.add(part, place, &target, key),
            FormErrorKind::UnknownName(_) | FormErrorKind::Value => false,
        };
        if is_mended || !self.can_continue() {
            return;
        }
        self.leave_ordered_list(place, &mut target);
        while !self.replace(part, place, &target, fault) {
            if target.len() <= place.len() {
                self.stand_in(place, part.stand_in());
                return;
            }
            target.pop();
        }
    }

    /// Moves from an entry, or from the number that orders it, to the list.
    fn leave_ordered_list(&self, place: &[usize], target: &mut Vec<usize>) {
        for above in [1, 2] {
            let Some(list) = target.len().checked_sub(above).filter(|&length| length > place.len()) else { return };
            let is_ordered =
                self.root.member_at(&target[..list]).is_some_and(|member| ORDERED.contains(&member.read_as.as_str()));
            let is_order = above == 1 || target.last() == Some(&0);
            if is_ordered && is_order && matches!(self.root.at(&target[..list]).map(|v| &v.body), Some(Body::Array(_)))
            {
                target.truncate(list);
                return;
            }
        }
    }

    /// Reads a key as the one that was probably meant, if its object lacks that key; its value may be replaced too.
    fn rename(&mut self, part: DocumentPart, place: &[usize], target: &[usize], meant: Option<&str>) -> bool {
        let Some(meant) = meant else { return false };
        let Some((_, parent)) = target.split_last() else { return false };
        let Some(object) = self.root.at(parent) else { return false };
        if object.members().iter().any(|member| !member.is_removed && member.read_as == meant) {
            return false;
        }
        let Some(member) = self.root.member_at_mut(target) else { return false };
        let before = std::mem::replace(&mut member.read_as, meant.to_owned());
        if self.is_mended(part, place, target, None) || self.replace_value(part, place, target, None) {
            return true;
        }
        if let Some(member) = self.root.member_at_mut(target) {
            member.read_as = before;
        }
        false
    }

    /// Leaves out an unknown key.
    fn remove(&mut self, target: &[usize]) {
        self.note_repair(target);
        if let Some(member) = self.root.member_at_mut(target) {
            member.is_removed = true;
            member.is_unknown = true;
        }
    }

    /// Whether an object has unknown keys in place of all its missing ones: then that is one mistake, not two.
    fn may_be_misnamed(&self, object: &[usize]) -> bool {
        let members = self.root.at(object).map(Value::members).unwrap_or_default();
        let unknown = members.iter().filter(|member| member.is_unknown).count();
        unknown > members.iter().filter(|member| member.is_added).count()
    }

    /// Path of a key that was left out of an object and turned out to be needed.
    fn removed(&self, object: &[usize], key: &str) -> Option<Vec<usize>> {
        let members = self.root.at(object)?.members();
        let index = members.iter().position(|member| member.is_removed && member.read_as == key)?;
        Some([object, &[index]].concat())
    }

    /// Adds a missing key to an object.
    fn add(&mut self, part: DocumentPart, place: &[usize], target: &[usize], key: &str) -> bool {
        if let Some(removed) = self.removed(target, key) {
            if let Some(member) = self.root.member_at_mut(&removed) {
                member.is_removed = false;
            }
            return self.replace_value(part, place, &removed, None);
        }
        let Some(object) = self.root.at_mut(target) else { return false };
        let Body::Object(members) = &mut object.body else { return false };
        members.push(Member::added(key, object.node, ""));
        let last = members.len() - 1;
        let added = [target, &[last]].concat();
        if self.replace_value(part, place, &added, None) {
            return true;
        }
        if let Some(Body::Object(members)) = self.root.at_mut(target).map(|object| &mut object.body) {
            members.pop();
        }
        false
    }

    /// Leaves a value out, or replaces it by something valid; returns whether that helped.
    fn replace(&mut self, part: DocumentPart, place: &[usize], target: &[usize], fault: &FormError) -> bool {
        if target.len() > place.len()
            && let Some(member) = self.root.member_at_mut(target)
        {
            let was_removed = std::mem::replace(&mut member.is_removed, true);
            if self.is_mended(part, place, target, Some(fault)) {
                self.note_repair(target);
                return true;
            }
            if let Some(member) = self.root.member_at_mut(target) {
                member.is_removed = was_removed;
            }
        }
        self.replace_value(part, place, target, Some(fault))
    }

    fn replace_value(
        &mut self,
        part: DocumentPart,
        place: &[usize],
        target: &[usize],
        fault: Option<&FormError>,
    ) -> bool {
        let Some(value) = self.root.at_mut(target) else { return false };
        let before = std::mem::replace(&mut value.body, Body::StandIn(String::new()));
        let known = fault.and_then(|fault| first_choice(&fault.message));
        for json in known.iter().map(String::as_str).chain(VALUES) {
            if !self.can_continue() {
                break;
            }
            if let Some(value) = self.root.at_mut(target) {
                value.body = Body::StandIn(json.to_owned());
            }
            if self.is_mended(part, place, target, fault) {
                self.note_repair(target);
                return true;
            }
        }
        if let Some(value) = self.root.at_mut(target) {
            value.body = before;
        }
        false
    }

    fn stand_in(&mut self, target: &[usize], json: &str) {
        self.note_repair(target);
        if let Some(value) = self.root.at_mut(target) {
            value.body = Body::StandIn(json.to_owned());
        }
    }

    fn note_repair(&mut self, target: &[usize]) {
        self.repaired.push(self.root.pointer(target, true));
    }

    fn is_mended(&mut self, part: DocumentPart, place: &[usize], target: &[usize], fault: Option<&FormError>) -> bool {
        match self.read(part, place) {
            Ok(()) => true,
            Err(next) => self.is_beside(place, target, &next, fault),
        }
    }

    /// Whether the next error has nothing to do with the repair at `target`.
    fn is_beside(&self, place: &[usize], target: &[usize], next: &FormError, fault: Option<&FormError>) -> bool {
        if fault.is_some_and(|fault| fault.pointer == next.pointer && fault.message == next.message) {
            return false;
        }
        let (whole, part) = (self.root.pointer(target, true), self.root.pointer(place, true));
        let done = steps(&whole).split_off(steps(&part).len());
        let mut wrong = steps(&next.pointer);
        if let FormErrorKind::MissingKey(key) = &next.kind {
            wrong.push(key.clone());
            return !wrong.starts_with(&done);
        }
        !wrong.starts_with(&done) && !done.starts_with(&wrong)
    }
}

/// The first name that a message lists, as JSON.
fn first_choice(message: &str) -> Option<String> {
    let (_, list) = message.split_once("did you mean `").or_else(|| message.split_once("choose one of `"))?;
    let (name, _) = list.split_once('`')?;
    Some(serde_json::Value::from(name).to_string())
}
