use super::*;

#[test]
fn conditions_and_the_protocol_are_listed() {
    let blocks = "[[at]]\ntime = 1\ninform = { select = { fraction = \"$share\" }, direction = 0 }\n[[at]]\n\
                  from = 2\nevery = 1\nset = { noise = { ramp = [0, 0.8] } }\n[[at]]\nwhen = \"order>0.9 \
                  for 2\"\nfrom = 3\nuninform = { select = { informed = true } }\nremove = [{ select = { \
                  count = 1 } }]\n[stop]\nwhen = \"order < 0.1 for 5\"\n";
    let text = format!(
        "name = \"a\"\nduration = 10\nreplicates = 2\nspec = {{ n = 9, dt = 0.1 }}\n[[grid]]\nshare = \
         [0.2, 0.5]\n{blocks}"
    );
    let plan = Plan::parse(&text).unwrap();
    let dry = DryRun::of(&plan, &Subset::all(&plan)).unwrap();
    assert!(dry.estimate.is_at_most);
    let lines = [
        "2 conditions, 4 runs",
        "  share=0.2",
        "  share=0.5",
        "protocol of run 1, share=0.2 #0, 100 steps:",
        "  line 8, 1 execution:",
        "    step 10, t = 1",
        "      inform = { direction = 0, select = { fraction = 0.2 } }",
        // The one at the end, with 0.8, is not executed.
        "  line 11, 8 executions:",
        "    step 20, t = 2",
        "      set = { noise = 0.0 }",
        "    step 30, t = 3",
        "      set = { noise = 0.1 }",
        "    step 40, t = 4",
        "      set = { noise = 0.2 }",
        "    … 4 more",
        "    step 90, t = 9",
        "      set = { noise = 0.7000000000000001 }",
        "  line 15, when order > 0.9 for 2, from step 30:",
        "      uninform = { select = { informed = true } }",
        "      remove = { select = { count = 1 } }",
        "  [stop] when order < 0.1 for 5",
    ];
    let shown = dry.to_string();
    let shown: Vec<&str> = shown.lines().take(lines.len()).collect();
    assert_eq!(shown, lines);
    // The first run of the subset is that whose protocol is shown.
    let last = DryRun::of(&plan, &Subset::of(vec![3])).unwrap();
    let protocol = last.protocol.unwrap();
    assert_eq!((last.runs, last.conditions, protocol.number), (1, 1, 4));
    let commands = &protocol.listed_blocks[0].listed_executions[0].commands;
    assert!(commands[0].contains("fraction = 0.5"), "{commands:?}");
}

#[test]
fn long_lists_are_abbreviated() {
    let list: Vec<String> = (1..=50).map(|n| n.to_string()).collect();
    let blocks = "[[at]]\ntime = 1\nset = { noise = 0 }\n".repeat(30);
    let text = format!(
        "name = \"a\"\nduration = 2\n[[grid]]\nn = [{}]\n{blocks}",
        list.join(", ")
    );
    let plan = Plan::parse(&text).unwrap();
    let dry = DryRun::of(&plan, &Subset::all(&plan)).unwrap();
    assert_eq!((dry.conditions, dry.listed_conditions.len()), (50, 20));
    let protocol = dry.protocol.as_ref().unwrap();
    assert_eq!((protocol.blocks, protocol.listed_blocks.len()), (30, 20));
    let shown = dry.to_string();
    assert!(shown.contains("\n  … 30 more\n"), "{shown}");
    assert!(shown.contains("\n  … 10 more\n"), "{shown}");
    assert!(!shown.contains("at most"), "{shown}");
}

#[test]
fn a_condition_that_never_holds_is_marked() {
    let text = "name = \"a\"\nduration = 2\n[[grid]]\nn = 5\n[stop]\nwhen = \"order > 1.5\"\n";
    let plan = Plan::parse(text).unwrap();
    let shown = DryRun::of(&plan, &Subset::all(&plan)).unwrap().to_string();
    let expected = "when order > 1.5 (order > 1.5 never holds: the range of order is 0 to 1; give a number within it)";
    assert!(shown.contains(expected), "{shown}");
    // Two time units are left, or one.
    for (duration, from, is_marked) in [(2.0, 0, false), (2.1, 0, true), (2.0, 1, true)] {
        let text = format!(
            "name = \"a\"\nduration = 2\n[[grid]]\nn = 5\n[stop]\n\
             when = \"order > 0.5 for {duration}\"\nfrom = {from}\n"
        );
        let plan = Plan::parse(&text).unwrap();
        let shown = DryRun::of(&plan, &Subset::all(&plan)).unwrap().to_string();
        assert_eq!(shown.contains("are left"), is_marked, "{shown}");
        // A block is not evaluated on the last state.
        let block = text.replace("[stop]\n", "[[at]]\nset = { noise = 0.1 }\n");
        let plan = Plan::parse(&block).unwrap();
        let shown = DryRun::of(&plan, &Subset::all(&plan)).unwrap().to_string();
        assert!(shown.contains("are left"), "{shown}");
    }
}
