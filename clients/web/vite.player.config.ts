import { createHash } from "node:crypto";
import { defineConfig, type Plugin } from "vite";

/** The sources that a policy admits by their hash. */
const admitted = (text: string) => `'sha256-${createHash("sha256").update(text).digest("base64")}'`;

/**
 * Puts script and style into the document, which then is one file that requests nothing: its policy
 * admits this script, this style, the engine, and the worker that the script makes of its own text.
 */
function inline(): Plugin {
  return {
    name: "inline",
    enforce: "post",
    generateBundle(_, bundle) {
      let [script, style] = ["", ""];
      const document = bundle["player.html"];
      for (const [name, it] of Object.entries(bundle)) {
        if (it.type === "chunk") {
          script += it.code;
        } else if (name.endsWith(".css")) {
          style += it.source;
        }
        if (it !== document) {
          delete bundle[name];
        }
      }
      if (document?.type !== "asset" || script === "" || style === "") {
        throw new Error("the player has no document, script or style");
      }
      if (/<\/(?:script|style)|\{\{jostle:/.test(script + style)) {
        throw new Error("the script or style contains what ends it, or a placeholder");
      }
      const policy = [
        "default-src 'none'",
        `script-src ${admitted(script)} 'wasm-unsafe-eval'`,
        `style-src ${admitted(style)}`,
        "worker-src blob:",
        "base-uri 'none'",
        "form-action 'none'",
      ];
      document.source = String(document.source)
        .replace(/\n *<script[^>]* src=[^>]*><\/script>/, "")
        .replace(/\n *<link[^>]* rel="stylesheet"[^>]*>/, "")
        .replace("{{policy}}", policy.join("; "))
        .replace("  </head>", () => `  <style>${style}</style>\n  </head>`)
        // After the content, which it reads.
        .replace("  </body>", () => `  <script>${script}</script>\n  </body>`);
    },
  };
}

export default defineConfig({
  publicDir: false,
  plugins: [inline()],
  build: {
    outDir: "dist-player",
    target: "es2022",
    modulePreload: false,
    cssCodeSplit: false,
    reportCompressedSize: false,
    rolldownOptions: { input: "player.html", output: { format: "iife", codeSplitting: false } },
  },
});
