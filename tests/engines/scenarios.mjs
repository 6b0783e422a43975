// Answers the requests of scenarios by a module: in Node, in a browser and in a worker of one.

/** An instance of the module, which holds nothing at first. */
class Engine {
  constructor(module) {
    // Without imports.
    this.exports = new WebAssembly.Instance(module, {}).exports;
  }

  /** Executes a request; returns the reply, or the text of a panic. */
  request(request) {
    const { input, request: execute, output, output_len, memory } = this.exports;
    const bytes = new TextEncoder().encode(request);
    const at = input(bytes.length);
    new Uint8Array(memory.buffer, at, bytes.length).set(bytes);
    let trap = "";
    try {
      execute();
    } catch (error) {
      trap = `trap: ${error}: `;
    }
    const start = output();
    // The call may have moved the memory.
    return trap + new TextDecoder().decode(new Uint8Array(memory.buffer, start, output_len()));
  }
}

/** Returns the replies to the lines of `requests`; an empty line begins another scenario. */
export function answer(module, requests) {
  let engine = new Engine(module);
  const replies = requests.split("\n").map((request) => {
    if (request === "") {
      engine = new Engine(module);
      return "";
    }
    return engine.request(request);
  });
  return replies.join("\n");
}
