/** The mark of a swarm of which an earlier version of the model computed steps. */
import type { EarlierModel } from "../wire/messages.ts";

/** The mark, such as `model 1 until step 50`; empty without earlier versions. */
export function modelMark(models: readonly EarlierModel[] | undefined): string {
  return (models ?? []).map((it) => `model ${it.model_version} until step ${it.step}`).join(", ");
}
