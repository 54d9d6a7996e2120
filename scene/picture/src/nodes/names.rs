//! Names of nodes and of their parts, in JSON and in documentation.

/// JSON pointer in a node of a material that it names; a placement's has the placement's index.
pub fn material_pointer(placement: Option<usize>) -> String {
    placement.map_or_else(|| "/material".to_owned(), |index| format!("/at/{index}/material"))
}
