//! Rewrites a source file so that it contains its mutants, and finds the mutants that an error of the compiler is in.

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::Path;

use proc_macro2::Span;
use quote::ToTokens;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::visit_mut::{self, VisitMut};
use syn::{BinOp, Block, Expr, ExprIf, GenericArgument, Lit, PathArguments, ReturnType, Type, UnOp, parse_quote};

/// One mutant.
#[derive(Debug)]
pub struct Mutant {
    pub number: u32,
    pub line: usize,
    /// Without the line, so that it stays the same when other code changes.
    pub what: String,
}

/// Visitor that adds the mutants, except the rejected ones.
pub struct Writer<'a> {
    pub rejected: &'a BTreeSet<u32>,
    pub mutants: Vec<Mutant>,
    /// Name of the function or constant.
    pub item: String,
    /// Folder of the file.
    pub folder: &'a Path,
    /// Mutants of the SQL constants of this file.
    pub constants: HashMap<String, Vec<(u32, String)>>,
    pub next: u32,
    /// Whether each field of a struct is also set to its default, as if a cache key did not contain it.
    pub fields: bool,
}

impl Writer<'_> {
    /// The number of a new mutant, unless the compiler has rejected it.
    fn add(&mut self, span: Span, what: String) -> Option<u32> {
        self.next += 1;
        if self.rejected.contains(&self.next) {
            return None;
        }
        let what = format!("{}: {what}", self.item);
        self.mutants.push(Mutant { number: self.next, line: span.start().line, what });
        Some(self.next)
    }

    fn function(&mut self, name: &syn::Ident, output: &ReturnType, block: &mut Block) {
        let outer = std::mem::replace(&mut self.item, name.to_string());
        visit_mut::visit_block_mut(self, block);
        for (text, value) in early_returns(output) {
            if let Some(n) = self.add(name.span(), format!("return {text}")) {
                block.stmts.insert(0, parse_quote!(if crate::mutant::is(#n) { return #value; }));
            }
        }
        self.item = outer;
    }

    fn sql_mutants(&mut self, span: Span, sql: &str) -> Vec<(u32, String)> {
        let mut mutants = Vec::new();
        for (at, from, to) in sql_places(sql) {
            let line = sql[..at].rsplit('\n').next().unwrap_or("").trim();
            let rest = sql[at + from.len()..].lines().next().unwrap_or("");
            let words = format!("SQL: `{line}` [{} to {}] `{}`", from.trim(), to.trim(), rest.trim());
            if let Some(n) = self.add(span, words) {
                mutants.push((n, format!("{}{to}{}", &sql[..at], &sql[at + from.len()..])));
            }
        }
        mutants
    }

    /// Collects the mutants of SQL constants, which are applied where the constants are used.
    pub fn constants(&mut self, file: &syn::File) {
        for item in &file.items {
            let syn::Item::Const(item) = item else { continue };
            let sql = match &*item.expr {
                Expr::Lit(literal) => literal_sql(&literal.lit),
                Expr::Macro(call) if call.mac.path.is_ident("include_str") => {
                    let name: syn::LitStr = call.mac.parse_body().expect("a file name");
                    Some(fs::read_to_string(self.folder.join(name.value())).expect("an SQL file"))
                }
                _ => None,
            };
            if let Some(sql) = sql {
                self.item = item.ident.to_string();
                let mutants = self.sql_mutants(item.ident.span(), &sql);
                self.constants.insert(item.ident.to_string(), mutants);
            }
        }
    }
}

impl VisitMut for Writer<'_> {
    fn visit_attribute_mut(&mut self, _: &mut syn::Attribute) {}
    fn visit_pat_mut(&mut self, _: &mut syn::Pat) {}
    fn visit_type_mut(&mut self, _: &mut Type) {}
    fn visit_item_const_mut(&mut self, _: &mut syn::ItemConst) {}
    fn visit_item_static_mut(&mut self, _: &mut syn::ItemStatic) {}
    fn visit_item_enum_mut(&mut self, _: &mut syn::ItemEnum) {}
    fn visit_impl_item_const_mut(&mut self, _: &mut syn::ImplItemConst) {}

    fn visit_item_mod_mut(&mut self, item: &mut syn::ItemMod) {
        if !item.attrs.iter().any(|attribute| attribute.to_token_stream().to_string().contains("cfg (test)")) {
            visit_mut::visit_item_mod_mut(self, item);
        }
    }

    fn visit_item_fn_mut(&mut self, item: &mut syn::ItemFn) {
        let is_test = item.attrs.iter().any(|attribute| attribute.to_token_stream().to_string().contains("test"));
        if item.sig.constness.is_none() && !is_test {
            self.function(&item.sig.ident, &item.sig.output, &mut item.block);
        }
    }

    fn visit_impl_item_fn_mut(&mut self, item: &mut syn::ImplItemFn) {
        let is_test = item.attrs.iter().any(|attribute| attribute.to_token_stream().to_string().contains("cfg (test)"));
        if item.sig.constness.is_none() && !is_test {
            self.function(&item.sig.ident, &item.sig.output, &mut item.block);
        }
    }

    fn visit_expr_mut(&mut self, expr: &mut Expr) {
        let original = expr.clone();
        match expr {
            Expr::Repeat(repeat) => self.visit_expr_mut(&mut repeat.expr),
            Expr::Struct(value) if self.fields => {
                for field in &mut value.fields {
                    self.visit_expr_mut(&mut field.expr);
                    let what = format!("default `{}`", text(&field.member));
                    let (Some(n), expr) = (self.add(field.member.span(), what), &field.expr) else { continue };
                    field.expr = parse_quote!(if crate::mutant::is(#n) { Default::default() } else { #expr });
                    field.colon_token = Some(parse_quote!(:));
                }
            }
            _ => visit_mut::visit_expr_mut(self, expr),
        }
        match original {
            Expr::Binary(mut binary) if !has_let(&binary.left) && !has_let(&binary.right) => {
                let Some(op) = opposite(&binary.op) else { return };
                let what = format!("`{}` with `{}`", text(&binary), op.to_token_stream());
                let Some(n) = self.add(binary.op.span(), what) else { return };
                binary.op = op;
                *expr = parse_quote!((if crate::mutant::is(#n) { #binary } else { #expr }));
            }
            Expr::Unary(unary) if matches!(unary.op, UnOp::Not(_)) => {
                let Some(n) = self.add(unary.span(), format!("`{}` without `!`", text(&unary))) else { return };
                let inner = unary.expr;
                *expr = parse_quote!((if crate::mutant::is(#n) { #inner } else { #expr }));
            }
            Expr::Lit(literal) => {
                let Some(sql) = literal_sql(&literal.lit) else { return };
                let mutants = self.sql_mutants(literal.span(), &sql);
                apply(expr, &mutants);
            }
            Expr::Path(path) => {
                let name = path.path.get_ident().map(ToString::to_string).unwrap_or_default();
                if let Some(mutants) = self.constants.get(&name) {
                    apply(expr, mutants);
                }
            }
            _ => {}
        }
    }
}

/// Beginning of an expression, on one line.
fn text(tokens: &impl ToTokens) -> String {
    let text = tokens.to_token_stream().to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    text.chars().take(100).collect()
}

/// Lets an expression choose among its SQL and the mutants of it.
fn apply(expr: &mut Expr, mutants: &[(u32, String)]) {
    if !mutants.is_empty() {
        let pairs = mutants.iter().map(|(n, sql)| quote::quote!((#n, #sql)));
        *expr = parse_quote!(crate::mutant::pick(#expr, &[#(#pairs),*]));
    }
}

fn has_let(expr: &Expr) -> bool {
    match expr {
        Expr::Let(_) => true,
        Expr::Binary(binary) => has_let(&binary.left) || has_let(&binary.right),
        _ => false,
    }
}

#[rustfmt::skip]
fn opposite(op: &BinOp) -> Option<BinOp> {
    Some(match op {
        BinOp::Eq(_) => parse_quote!(!=), BinOp::Ne(_) => parse_quote!(==),
        BinOp::Lt(_) => parse_quote!(<=), BinOp::Le(_) => parse_quote!(<),
        BinOp::Gt(_) => parse_quote!(>=), BinOp::Ge(_) => parse_quote!(>),
        BinOp::And(_) => parse_quote!(||), BinOp::Or(_) => parse_quote!(&&),
        BinOp::Add(_) => parse_quote!(-), BinOp::Sub(_) => parse_quote!(+),
        BinOp::Mul(_) => parse_quote!(/), BinOp::Div(_) => parse_quote!(*),
        BinOp::BitAnd(_) => parse_quote!(|), BinOp::BitOr(_) => parse_quote!(&),
        BinOp::AddAssign(_) => parse_quote!(-=), BinOp::SubAssign(_) => parse_quote!(+=),
        _ => return None,
    })
}

/// The values that a function can return at once, as text and as an expression.
fn early_returns(output: &ReturnType) -> Vec<(String, Expr)> {
    let values: Vec<Expr> = match output {
        ReturnType::Default => return vec![("at once".to_owned(), parse_quote!(()))],
        ReturnType::Type(_, ty) => {
            let name = last_name(ty);
            match name.as_str() {
                "bool" => vec![parse_quote!(true), parse_quote!(false)],
                "Option" => vec![parse_quote!(None)],
                "Result" => match argument(ty) {
                    Some(Type::Tuple(tuple)) if tuple.elems.is_empty() => vec![parse_quote!(Ok(()))],
                    Some(inner) if last_name(inner) == "bool" => vec![parse_quote!(Ok(true)), parse_quote!(Ok(false))],
                    Some(inner) if last_name(inner) == "Option" => vec![parse_quote!(Ok(None))],
                    _ => vec![],
                },
                _ => vec![],
            }
        }
    };
    values.into_iter().map(|value| (value.to_token_stream().to_string(), value)).collect()
}

fn last_name(ty: &Type) -> String {
    let Type::Path(path) = ty else { return String::new() };
    path.path.segments.last().map(|segment| segment.ident.to_string()).unwrap_or_default()
}

fn argument(ty: &Type) -> Option<&Type> {
    let Type::Path(path) = ty else { return None };
    let PathArguments::AngleBracketed(arguments) = &path.path.segments.last()?.arguments else { return None };
    match arguments.args.first()? {
        GenericArgument::Type(ty) => Some(ty),
        _ => None,
    }
}

fn literal_sql(literal: &Lit) -> Option<String> {
    let Lit::Str(text) = literal else { return None };
    let text = text.value();
    ["SELECT ", "UPDATE ", "DELETE FROM ", "INSERT INTO "].iter().any(|word| text.contains(word)).then_some(text)
}

/// Places of an SQL text that a mutant changes: byte offset, text and replacement.
fn sql_places(sql: &str) -> Vec<(usize, &'static str, &'static str)> {
    const PAIRS: [(&str, &str); 8] = [
        (" = ", " <> "),
        (" < ", " <= "),
        (" > ", " >= "),
        (" AND ", " OR "),
        (" + ", " - "),
        (" IS NULL", " IS NOT NULL"),
        ("max(", "min("),
        (" EXISTS ", " NOT EXISTS "),
    ];
    let both = PAIRS.iter().flat_map(|&(a, b)| [(a, b), (b, a)]);
    let mut places = Vec::new();
    for (from, to) in both {
        for (at, _) in sql.match_indices(from) {
            let before = &sql[..at];
            let is_assignment = from == " = "
                && before.rfind("SET ").is_some_and(|set| {
                    ["WHERE", "FROM", " ON ", "RETURNING"]
                        .iter()
                        .all(|word| before.rfind(word).is_none_or(|at| at < set))
                });
            let is_negated = from == " EXISTS " && before.ends_with("NOT");
            // A partial index that a statement names has to fit its condition.
            let is_indexed = from == " IS NULL" && before.contains("INDEXED BY");
            if !is_assignment && !is_negated && !is_indexed {
                places.push((at, from, to));
            }
        }
    }
    places.sort_by_key(|(at, ..)| *at);
    places
}

/// Finds the mutants around a place of a rewritten file: the innermost, or all of the function.
pub struct Finder {
    pub line: usize,
    pub column: usize,
    pub innermost: Option<u32>,
    pub in_function: Vec<u32>,
    depth_found: bool,
}

impl Finder {
    pub fn new(line: usize, column: usize) -> Self {
        Self { line, column, innermost: None, in_function: Vec::new(), depth_found: false }
    }

    fn is_in(&self, span: Span) -> bool {
        let (start, end) = (span.start(), span.end());
        (start.line, start.column + 1) <= (self.line, self.column)
            && (self.line, self.column) <= (end.line, end.column + 1)
    }
}

impl<'ast> Visit<'ast> for Finder {
    fn visit_block(&mut self, block: &'ast Block) {
        let is_outer = self.is_in(block.span()) && !self.depth_found;
        if is_outer {
            self.depth_found = true;
        }
        visit::visit_block(self, block);
        self.depth_found &= !is_outer;
    }

    fn visit_expr_if(&mut self, expr: &'ast ExprIf) {
        if let Expr::Call(call) = &*expr.cond
            && call.func.to_token_stream().to_string().ends_with("mutant :: is")
            && let Some(Expr::Lit(literal)) = call.args.first()
            && let Lit::Int(n) = &literal.lit
        {
            let n = n.base10_parse().expect("a mutant's number");
            if self.is_in(expr.span()) {
                self.innermost = Some(n);
            }
            if self.depth_found {
                self.in_function.push(n);
            }
        }
        visit::visit_expr_if(self, expr);
    }
}
