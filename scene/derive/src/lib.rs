//! `#[derive(Seek)]`: visits every number of a type, so that no field of the job language can be missed.
//!
//! A field whose type does not implement `picture::seek::Seek` does not compile. Fields that serde skips are derived
//! from the others. They implement `Invalidate`, and are invalidated when a number in the same type is animated.

use proc_macro2::TokenStream;
use quote::{format_ident, quote};
use syn::{Attribute, Data, DeriveInput, Fields, Ident, Index, Member, parse_macro_input};

/// Implements `crate::seek::Seek` by seeking every field of a struct, or of the current variant of an enum.
///
/// `#[seek(then = method)]` on the type calls `self.method()`, which may fail with a message, after its fields if
/// one of them is animated.
#[proc_macro_derive(Seek, attributes(seek))]
pub fn derive_seek(input: proc_macro::TokenStream) -> proc_macro::TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    implementation(&input).unwrap_or_else(|error| error.to_compile_error()).into()
}

fn implementation(input: &DeriveInput) -> syn::Result<TokenStream> {
    let name = &input.ident;
    let walk = match &input.data {
        Data::Struct(data) => fields_of_struct(&data.fields)?,
        Data::Enum(data) => {
            let arms = data.variants.iter().map(|variant| arm(&variant.ident, &variant.fields));
            let arms = arms.collect::<syn::Result<Vec<_>>>()?;
            quote! { match self { #(#arms)* } }
        }
        Data::Union(_) => return Err(syn::Error::new_spanned(name, "a union has no fields to seek")),
    };
    let then = then(&input.attrs)?.map(|method| {
        quote! {
            if is_animated {
                self.#method()?;
            }
        }
    });
    let mut generics = input.generics.clone();
    for parameter in input.generics.type_params() {
        let parameter = &parameter.ident;
        generics.make_where_clause().predicates.push(syn::parse_quote!(#parameter: crate::seek::Seek));
    }
    let (impl_generics, type_generics, where_clause) = generics.split_for_impl();
    Ok(quote! {
        impl #impl_generics crate::seek::Seek for #name #type_generics #where_clause {
            fn seek(
                &mut self,
                clock: &mut crate::seek::FrameTime<'_>,
            ) -> ::core::result::Result<bool, ::std::boxed::Box<crate::seek::SeekError>> {
                let is_animated = { #walk };
                #then
                ::core::result::Result::Ok(is_animated)
            }
        }
    })
}

/// The method of `#[seek(then = method)]`.
fn then(attributes: &[Attribute]) -> syn::Result<Option<Ident>> {
    let mut found = None;
    for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("seek")) {
        attribute.parse_nested_meta(|meta| {
            if !meta.path.is_ident("then") {
                return Err(meta.error("expected `then = method`"));
            }
            found = Some(meta.value()?.parse()?);
            Ok(())
        })?;
    }
    Ok(found)
}

fn fields_of_struct(fields: &Fields) -> syn::Result<TokenStream> {
    let members: Vec<Member> = fields.members().collect();
    let places = members.iter().map(|member| quote! { &mut self.#member }).collect::<Vec<_>>();
    walk(fields, &places)
}

fn arm(variant: &Ident, fields: &Fields) -> syn::Result<TokenStream> {
    let bindings: Vec<Ident> = (0..fields.len()).map(|index| format_ident!("field_{index}")).collect();
    let pattern = match fields {
        Fields::Named(named) => {
            let names = named.named.iter().filter_map(|field| field.ident.as_ref());
            quote! { { #(#names: #bindings),* } }
        }
        Fields::Unnamed(_) => quote! { ( #(#bindings),* ) },
        Fields::Unit => quote! {},
    };
    let places = bindings.iter().map(|binding| quote! { #binding }).collect::<Vec<_>>();
    let walk = walk(fields, &places)?;
    let key = snake_case(&variant.to_string());
    // A variant without parameters has no JSON member of its own.
    if fields.is_empty() {
        return Ok(quote! { Self::#variant #pattern => #walk, });
    }
    Ok(quote! {
        Self::#variant #pattern => {
            let mut inside = || -> ::core::result::Result<bool, ::std::boxed::Box<crate::seek::SeekError>> {
                ::core::result::Result::Ok(#walk)
            };
            inside().map_err(|misfit| misfit.inside(#key))?
        }
    })
}

/// Seeks the fields that appear in JSON, then recomputes the skipped ones. `places` are mutable references to the
/// fields.
fn walk(fields: &Fields, places: &[TokenStream]) -> syn::Result<TokenStream> {
    let is_transparent = matches!(fields, Fields::Unnamed(_)) && fields.len() == 1;
    let (mut seeks, mut renewals) = (Vec::new(), Vec::new());
    for ((index, field), place) in fields.iter().enumerate().zip(places) {
        if is_skipped(&field.attrs)? {
            renewals.push(quote! { crate::seek::Invalidate::invalidate(#place); });
            continue;
        }
        let seek = quote! { crate::seek::Seek::seek(#place, clock) };
        let key = match &field.ident {
            Some(name) => name.to_string().trim_start_matches("r#").to_owned(),
            None => Index::from(index).index.to_string(),
        };
        seeks.push(if is_transparent {
            quote! { is_animated |= #seek?; }
        } else {
            quote! { is_animated |= #seek.map_err(|misfit| misfit.inside(#key))?; }
        });
    }
    if seeks.is_empty() {
        return Ok(quote! { false });
    }
    let invalidate = (!renewals.is_empty()).then(|| {
        quote! {
            if is_animated {
                #(#renewals)*
            }
        }
    });
    Ok(quote! { {
        let mut is_animated = false;
        #(#seeks)*
        #invalidate
        is_animated
    } })
}

/// Whether serde skips a field. Renamed fields are rejected, because errors would point to the wrong JSON member.
fn is_skipped(attributes: &[Attribute]) -> syn::Result<bool> {
    let mut is_skipped = false;
    for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("serde")) {
        attribute.parse_nested_meta(|meta| {
            is_skipped |= meta.path.is_ident("skip");
            if meta.path.is_ident("rename") || meta.path.is_ident("flatten") {
                return Err(meta.error("`Seek` supports neither `rename` nor `flatten`: name fields as in JSON"));
            }
            if meta.input.peek(syn::Token![=]) {
                meta.value()?.parse::<syn::Expr>()?;
            }
            Ok(())
        })?;
    }
    Ok(is_skipped)
}

/// JSON name of a variant: `CappedTorus` becomes `capped_torus`.
fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    for (index, letter) in name.char_indices() {
        if letter.is_ascii_uppercase() && index > 0 {
            snake.push('_');
        }
        snake.push(letter.to_ascii_lowercase());
    }
    snake
}
