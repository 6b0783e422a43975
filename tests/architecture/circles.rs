//! Import circles of source files: there are none.
//!
//! An edge leads from a file to the file that defines an item which it names by a path through
//! `crate::` or `super::`; a re-export is followed to the definition. `mod` items, re-exports,
//! visibilities and code for tests alone are no edges.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, ItemMod, ItemUse, Macro, UseTree, Visibility};

/// The circles that are allowed, by crate root.
const CIRCLES: [(&str, &[&[&str]]); 11] = [
    ("src/lib.rs", &[]),
    ("clients/cli/src/main.rs", &[]),
    ("clients/rust/src/lib.rs", &[]),
    ("crates/conditions/src/lib.rs", &[]),
    ("crates/convert/src/lib.rs", &[]),
    ("crates/experiment/src/lib.rs", &[]),
    ("crates/figures/src/lib.rs", &[]),
    ("crates/measures/src/lib.rs", &[]),
    ("crates/physics/src/lib.rs", &[]),
    ("crates/results/src/lib.rs", &[]),
    ("proto/src/lib.rs", &[]),
];

/// Names from the crate root on.
type Names = Vec<String>;

#[derive(Default)]
struct Module {
    file: PathBuf,
    /// Items that are defined here.
    items: BTreeSet<String>,
    /// What each name stands for that is imported or re-exported here.
    uses: BTreeMap<String, Names>,
    /// Modules all of whose names are.
    globs: Vec<Names>,
    /// Paths through `crate::` or `super::` that are named here.
    named: Vec<Names>,
}

#[derive(Default)]
struct Crate {
    modules: BTreeMap<Names, Module>,
}

/// Reads one module.
struct Reader<'a> {
    read: &'a mut Crate,
    at: Names,
    /// The file, and the folder of its `mod` items.
    file: PathBuf,
    folder: PathBuf,
}

impl Crate {
    fn read(root: &Path) -> Self {
        let mut read = Self::default();
        let folder = root.parent().unwrap().to_owned();
        Reader::file(&mut read, Vec::new(), root.to_owned(), folder);
        read
    }

    /// The module that defines the item of `path`, if it is in this crate.
    fn definition(&self, path: &[String]) -> &Module {
        self.follow(path, &mut BTreeSet::new())
    }

    /// [`Crate::definition`] of a path that is not among `followed`: names may lead to each other.
    fn follow(&self, path: &[String], followed: &mut BTreeSet<Names>) -> &Module {
        let is_new = followed.insert(path.to_vec());
        let mut at: &[String] = &[];
        for (depth, name) in path.iter().enumerate() {
            if self.modules.contains_key(&path[..=depth]) {
                at = &path[..=depth];
                continue;
            }
            let module = &self.modules[at];
            if !is_new {
                break;
            }
            let rest = &path[depth + 1..];
            if let Some(target) = module.uses.get(name)
                && !path.starts_with(target)
            {
                return self.follow(&[target, rest].concat(), followed);
            }
            let has = |glob: &&Names| self.modules.get(*glob).is_some_and(|it| it.defines(name));
            if !module.items.contains(name)
                && let Some(glob) = module.globs.iter().find(has)
            {
                let path = [glob, std::slice::from_ref(name), rest].concat();
                return self.follow(&path, followed);
            }
            break;
        }
        &self.modules[at]
    }

    fn edges(&self) -> BTreeMap<&Path, BTreeSet<&Path>> {
        let mut edges: BTreeMap<&Path, BTreeSet<&Path>> = BTreeMap::new();
        for module in self.modules.values() {
            let targets = edges.entry(&module.file).or_default();
            let files = module.named.iter().map(|path| &*self.definition(path).file);
            targets.extend(files.filter(|file| *file != module.file));
        }
        edges
    }
}

impl Module {
    fn defines(&self, name: &str) -> bool {
        self.items.contains(name) || self.uses.contains_key(name)
    }
}

impl Reader<'_> {
    fn file(read: &mut Crate, at: Names, file: PathBuf, folder: PathBuf) {
        let text = std::fs::read_to_string(&file).unwrap_or_else(|it| panic!("{file:?}: {it}"));
        let parsed = syn::parse_file(&text).unwrap();
        let mut reader = Reader {
            read,
            at,
            file,
            folder,
        };
        reader.module(&parsed.items);
    }

    fn module(&mut self, items: &[Item]) {
        let file = self.file.clone();
        self.read.modules.entry(self.at.clone()).or_default().file = file;
        items.iter().for_each(|item| self.visit_item(item));
    }

    fn current(&mut self) -> &mut Module {
        self.read.modules.get_mut(&self.at).unwrap()
    }

    /// A path from the crate root on; none if it leads out of the crate or is relative.
    fn absolute(&self, path: &[String]) -> Option<Names> {
        let mut names = match path.first()?.as_str() {
            "crate" => Vec::new(),
            "super" => self.at[..self.at.len().checked_sub(1)?].to_vec(),
            _ => return None,
        };
        for name in &path[1..] {
            match name.as_str() {
                "super" => drop(names.pop()?),
                "self" => (),
                _ => names.push(name.clone()),
            }
        }
        Some(names)
    }

    fn name(&mut self, path: &[String]) {
        if let Some(path) = self.absolute(path) {
            self.current().named.push(path);
        }
    }

    fn take_use(&mut self, tree: &UseTree, before: &[String], is_export: bool) {
        let with = |ident: &syn::Ident| [before, &[ident.to_string()]].concat();
        let (path, alias) = match tree {
            UseTree::Path(path) => return self.take_use(&path.tree, &with(&path.ident), is_export),
            UseTree::Group(group) => {
                let trees = group.items.iter();
                return trees.for_each(|tree| self.take_use(tree, before, is_export));
            }
            UseTree::Glob(_) => (before.to_vec(), None),
            UseTree::Name(name) if name.ident == "self" => {
                (before.to_vec(), before.last().cloned())
            }
            UseTree::Name(name) => (with(&name.ident), Some(name.ident.to_string())),
            UseTree::Rename(name) => (with(&name.ident), Some(name.rename.to_string())),
        };
        if !is_export {
            self.name(&path);
        }
        // A path may also begin with `self`, or with the name of a module that is declared here.
        let is_self = path.first().is_some_and(|it| it == "self");
        let from_here = [&*self.at, &path[usize::from(is_self)..]].concat();
        let target = self.absolute(&path).unwrap_or(from_here);
        match alias {
            Some(alias) => drop(self.current().uses.insert(alias, target)),
            None => self.current().globs.push(target),
        }
    }

    fn scan(&mut self, tokens: TokenStream) {
        let mut path: Names = Vec::new();
        let mut colons = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(ident) if colons == 2 => path.push(ident.to_string()),
                TokenTree::Ident(ident) => {
                    self.name(&path);
                    path = vec![ident.to_string()];
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' => {
                    colons += 1;
                    continue;
                }
                TokenTree::Group(group) => self.scan(group.stream()),
                _ => {
                    self.name(&path);
                    path.clear();
                }
            }
            colons = 0;
        }
        self.name(&path);
    }
}

fn is_for_tests(attributes: &[Attribute]) -> bool {
    let mut cfgs = attributes.iter().filter(|it| it.path().is_ident("cfg"));
    cfgs.any(|it| {
        it.parse_args::<syn::Path>()
            .is_ok_and(|it| it.is_ident("test"))
    })
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        let (attributes, ident) = match item {
            Item::Const(it) => (&it.attrs, Some(&it.ident)),
            Item::Enum(it) => (&it.attrs, Some(&it.ident)),
            Item::Fn(it) => (&it.attrs, Some(&it.sig.ident)),
            Item::Static(it) => (&it.attrs, Some(&it.ident)),
            Item::Struct(it) => (&it.attrs, Some(&it.ident)),
            Item::Trait(it) => (&it.attrs, Some(&it.ident)),
            Item::Type(it) => (&it.attrs, Some(&it.ident)),
            Item::Macro(it) => (&it.attrs, it.ident.as_ref()),
            Item::Mod(it) => (&it.attrs, None),
            Item::Use(it) => (&it.attrs, None),
            Item::Impl(it) => (&it.attrs, None),
            _ => return visit::visit_item(self, item),
        };
        if is_for_tests(attributes) {
            return;
        }
        if let Some(ident) = ident {
            let ident = ident.to_string();
            self.current().items.insert(ident);
        }
        visit::visit_item(self, item);
    }

    /// A visibility such as `pub(super)` is no edge.
    fn visit_visibility(&mut self, _: &'ast Visibility) {}

    fn visit_item_mod(&mut self, item: &'ast ItemMod) {
        let name = item.ident.to_string();
        let at = [&*self.at, std::slice::from_ref(&name)].concat();
        let folder = self.folder.join(&name);
        if let Some((_, items)) = &item.content {
            let file = self.file.clone();
            let mut inner = Reader {
                read: self.read,
                at,
                file,
                folder,
            };
            return inner.module(items);
        }
        let beside = self.folder.join(format!("{name}.rs"));
        let file = if beside.exists() {
            beside
        } else {
            folder.join("mod.rs")
        };
        Reader::file(self.read, at, file, folder);
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        let is_export = !matches!(item.vis, Visibility::Inherited);
        self.take_use(&item.tree, &[], is_export);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Names = path
            .segments
            .iter()
            .map(|it| it.ident.to_string())
            .collect();
        self.name(&names);
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'ast Macro) {
        self.scan(item.tokens.clone());
    }
}

/// Sets of files that reach each other.
fn circles<'a>(edges: &BTreeMap<&'a Path, BTreeSet<&'a Path>>) -> BTreeSet<Vec<&'a Path>> {
    let mut reached = edges.clone();
    for &through in edges.keys() {
        let further = reached[through].clone();
        for targets in reached.values_mut() {
            if targets.contains(through) {
                targets.extend(&further);
            }
        }
    }
    let both =
        |one: &Path, other: &Path| reached[one].contains(other) && reached[other].contains(one);
    let together = edges.keys().map(|&one| {
        let others = edges.keys().copied();
        others.filter(|&other| both(one, other)).collect::<Vec<_>>()
    });
    together.filter(|circle| circle.len() > 1).collect()
}

#[test]
fn no_import_circle_but_these() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut different = Vec::new();
    for (root, expected) in CIRCLES {
        let read = Crate::read(&here.join(root));
        let edges = read.edges();
        assert!(
            edges.values().any(|targets| !targets.is_empty()),
            "{root}: no edge"
        );
        let short = |file: &Path| {
            file.strip_prefix(here)
                .unwrap()
                .to_str()
                .unwrap()
                .to_owned()
        };
        let found: BTreeSet<Vec<String>> = circles(&edges)
            .iter()
            .map(|circle| circle.iter().map(|file| short(file)).collect())
            .collect();
        let expected: BTreeSet<Vec<String>> = expected
            .iter()
            .map(|circle| circle.iter().map(|&file| file.to_owned()).collect())
            .collect();
        if found != expected {
            different.push(format!("{root}: {found:#?}"));
        }
    }
    assert!(different.is_empty(), "{}", different.join("\n"));
}

/// A crate of four files in which two import each other by way of a re-export, and one file only for tests.
#[test]
fn a_circle_through_a_re_export_is_found_and_one_of_tests_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("lib.rs", "mod a; mod b; mod c; pub use b::*;");
    write("a.rs", "pub struct A; fn f() { let _ = vec![crate::B]; }");
    write("b.rs", "pub struct B; pub fn g(_: super::a::A) {}");
    write(
        "c.rs",
        "use crate::a::A; #[cfg(test)] mod tests { use crate::c::C; }",
    );
    let read = Crate::read(&folder.path().join("lib.rs"));
    let edges = read.edges();
    let names: Vec<Vec<&str>> = circles(&edges)
        .iter()
        .map(|circle| {
            circle
                .iter()
                .map(|file| file.file_name().unwrap().to_str().unwrap())
                .collect()
        })
        .collect();
    assert_eq!(names, [["a.rs", "b.rs"]]);
}
