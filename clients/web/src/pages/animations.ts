/**
 * The seven animations attached to the paper, its references [35] and [39], with the parameters
 * and seeds of `paper/animations.toml`: the same groups as in `docs/reproduction.md`.
 *
 * The paper gives no number of individuals for [35] nor whether some are informed; the
 * red lines are the preference vectors p, eq. (3).
 */
import type { Spec } from "../wire/requests.ts";

export interface Animation {
  /** The swarm's name. */
  swarm: string;
  reference: string;
  title: string;
  spec: Spec;
  /** How many are informed of +x at the start. */
  informed: number;
  preferences: boolean;
  look: string;
}

const USUAL: Spec = {
  n: 50,
  pi1: 4,
  pi2: 0.5,
  pi3: 1,
  pi4: 10,
  dt: 0.02,
  rate: 5,
  publish_every: 5,
};

export const ANIMATIONS: Animation[] = [
  {
    swarm: "animation-1",
    reference: "[35] 1",
    title: "Original parameters",
    spec: { ...USUAL, seed: 5421423068289429 },
    informed: 10,
    preferences: true,
    look: "Uninformed bodies turn towards the group only, yet contacts align neighbours, and clusters with a common heading form and dissolve. The ten orange individuals are informed of +x: the drift shows how far they lead the group.",
  },
  {
    swarm: "animation-2-pi3-low",
    reference: "[35] 2",
    title: "π3 = 0.1: slow turning",
    spec: { ...USUAL, pi3: 0.1, seed: 383217765923619 },
    informed: 10,
    preferences: true,
    look: "Turning is ten times slower than in the first animation: paths are long arcs, and the group is loose. The paper finds hardly any contact; here there is about half as much as in the first. Compare the contacts per individual.",
  },
  {
    swarm: "animation-3-pi3-high",
    reference: "[35] 3",
    title: "π3 = 10: quick turning",
    spec: { ...USUAL, pi3: 10, seed: 6575033691187541 },
    informed: 10,
    preferences: true,
    look: "Individuals turn towards the group so quickly that it contracts to a dense ball: the drift stays near zero although ten are informed, and the order is low. Nearly every body touches another at any time.",
  },
  {
    swarm: "animation-4-pi4-low",
    reference: "[35] 4",
    title: "π4 = 1: contacts hardly turn bodies",
    spec: { ...USUAL, pi4: 1, seed: 5194409676321886 },
    informed: 10,
    preferences: true,
    look: "A push off centre moves a body rather than turning it, so bodies that meet keep their headings and slide along each other. Contacts no longer align neighbours: compare the order with that of the first animation.",
  },
  {
    swarm: "animation-5-pi4-high",
    reference: "[35] 5",
    title: "π4 = 100: contacts turn bodies easily",
    spec: { ...USUAL, pi4: 100, seed: 6551935668636473 },
    informed: 10,
    preferences: true,
    look: "A small push off centre turns a body, so bodies that meet align side by side. Look for aligned pairs whose red lines point in another direction: contact keeps their heading. In our tables just under half of all individuals have another at their side, hardly more than with the original parameters.",
  },
  {
    swarm: "animation-6-discs",
    reference: "[39] 1",
    title: "Fifty discs",
    spec: { ...USUAL, pi1: 1, seed: 7144187709157662 },
    informed: 0,
    preferences: false,
    look: "Discs cannot turn each other, so nothing aligns them: all move inwards and pack into a round cluster, each heading for its centre. The order stays close to zero, below that of fifty random headings (0.125).",
  },
  {
    swarm: "animation-7-elongated",
    reference: "[39] 2",
    title: "Fifty elongated bodies",
    spec: { ...USUAL, seed: 5421423068289429 },
    informed: 0,
    preferences: false,
    look: "The same attraction, but the bodies are four times as long as wide. Clusters align, leave the group, are turned back by its attraction and form again: the order rises and falls, far above that of the discs. No individual is informed, so the direction is random.",
  },
];
