// Prints the replies to scenarios, by Node: node node.mjs MODULE REQUESTS

import { readFileSync, writeSync } from "node:fs";

import { answer } from "./scenarios.mjs";

const [module, requests] = process.argv.slice(2);
const compiled = new WebAssembly.Module(readFileSync(module));
const replies = Buffer.from(answer(compiled, readFileSync(requests, "utf8")));
for (let written = 0; written < replies.length; ) {
  written += writeSync(1, replies, written);
}
