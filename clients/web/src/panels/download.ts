/** The button that downloads the commands of a swarm as the file of an experiment. */
import { attempt } from "../ui/announce.ts";
import { button } from "../ui/dom.ts";
import { get } from "../wire/http.ts";
import type { ExperimentFile } from "../wire/messages.ts";

export function downloadButton(swarm: string): HTMLButtonElement {
  const element = button("Download as experiment", () =>
    attempt(async () => {
      const { file } = (await get<ExperimentFile>(swarm, "experiment")).result;
      save(`${swarm}.toml`, file);
    }, `downloaded ${swarm}.toml`),
  );
  element.title =
    "The commands since the swarm's start, as a file whose run ends with the swarm's hash";
  return element;
}

/** Saves a text as a file of the browser. */
function save(name: string, text: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "application/toml" }));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}
