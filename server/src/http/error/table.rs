//! How the table of errors is written: a row has an error, its message, and the response to it.
//!
//! The rows are in `error.rs`. Responses and their description in the `OpenAPI` document are made from them alone.

use axum::http::{HeaderName, StatusCode};

/// Response to a kind of error, without what differs each time.
#[derive(Clone, Debug)]
pub(in crate::http) struct ErrorResponse {
    /// Status.
    pub(in crate::http) status: StatusCode,
    /// Stable code, by which programs tell problems apart.
    pub(in crate::http) code: &'static str,
    /// Title for people.
    pub(in crate::http) title: &'static str,
    /// Header that it has besides.
    pub(in crate::http) header: Option<HeaderName>,
}

/// Declares the errors: `Variant => STATUS "code" "title", HEADER = value;`. A value may use the variant's fields.
///
/// The derive stands with the rows, because its messages name the fields.
macro_rules! errors {
    (@header) => { None };
    (@header $header:ident $value:expr) => { Some($value) };
    ($(#[$($outer:tt)*])* $visibility:vis enum ApiError; $(
        $(#[$($attribute:tt)*])*
        $name:ident $(($($tuple:tt)*))? $({ $($field:ident: $kind:ty),* })?
            => $status:ident $code:literal $title:literal $(, $header:ident = $value:expr)?;
    )*) => {
        $(#[$($outer)*])*
        $visibility enum ApiError {$(
            $(#[$($attribute)*])*
            $name $(($($tuple)*))? $({ $($field: $kind),* })?,
        )*}

        /// An error without its values.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum ErrorKind {$($name,)*}

        impl ErrorKind {
            /// Every kind of error.
            #[cfg(test)]
            pub(super) const ALL: &[Self] = &[$(Self::$name),*];

            /// Its row of the table.
            pub(super) fn response(self) -> table::ErrorResponse {
                let (status, code, title, header) = match self {$(
                    Self::$name => (StatusCode::$status, $code, $title, table::errors!(@header $($header header::$header)?)),
                )*};
                table::ErrorResponse { status, code, title, header }
            }
        }

        impl ApiError {
            /// Its kind.
            fn kind(&self) -> ErrorKind {
                match self {$(Self::$name { .. } => ErrorKind::$name,)*}
            }

            /// Value of the header of its response.
            #[expect(unused_variables, reason = "the values of few headers depend on a field")]
            fn header_value(&self) -> Option<String> {
                match self {$(
                    Self::$name { $($($field,)*)? .. } => table::errors!(@header $($header $value.to_string())?),
                )*}
            }
        }
    };
}

pub(super) use errors;
