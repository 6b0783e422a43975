// Holds an AsyncAPI document to the specification, and every example in it to its schema.
//
//   node check.js asyncapi.json

import { readFileSync } from "node:fs";
import { dirname, resolve } from "node:path";
import { Parser, fromFile } from "@asyncapi/parser";
import { Ajv2020 } from "ajv/dist/2020.js";

const path = process.argv[2];
const problems = [];

// Errors are 0, warnings 1; what is below is a matter of taste.
const { document, diagnostics } = await fromFile(new Parser(), path).parse();
for (const { severity, code, message, path: place } of diagnostics) {
  const line = `${code}: ${message} (${place.join(".")})`;
  if (severity <= 1) problems.push(line);
  else console.log(`noted: ${line}`);
}
if (!document) problems.push("the parser gives no document");

const ajv = new Ajv2020({ strict: true, allErrors: true, strictTypes: false });
// Rust's kinds of numbers say how large one may be, which `maximum` says too where it matters.
for (const format of ["uint8", "uint32", "uint64", "int64", "uint", "double"]) ajv.addFormat(format, true);
// What a form wants to know of a parameter.
for (const keyword of ["x-unit", "x-changed-by", "x-range", "x-usual"]) ajv.addKeyword(keyword);

const folder = resolve(dirname(path), "schema");
for (const file of ["received.json", "sent.json"]) {
  ajv.addSchema(JSON.parse(readFileSync(resolve(folder, file), "utf8")), file);
}

const { components } = JSON.parse(readFileSync(path, "utf8"));
let examples = 0;
for (const [name, message] of Object.entries(components.messages)) {
  if (!message.payload) continue;
  const validate = ajv.getSchema(message.payload.$ref.replace("./schema/", ""));
  if (!validate) {
    problems.push(`${name}: there is no ${message.payload.$ref}`);
    continue;
  }
  if (!message.examples.length) problems.push(`${name} has no example`);
  for (const example of message.examples) {
    examples += 1;
    if (!validate(example.payload)) {
      problems.push(`${name}, example ${example.name}: ${ajv.errorsText(validate.errors)}`);
    }
  }
}

for (const problem of problems) console.error(problem);
if (problems.length) process.exit(1);
const count = (items) => items.all().length;
console.log(
  `${path}: ${count(document.channels())} channels, ${count(document.operations())} operations, ` +
    `${count(document.components().messages())} messages, ${examples} examples: no error, no warning`,
);
