/* Order of what the search finds: pages whose title has the words, sections, entries of the index, pages with a word
   in the title of a section, and all others. */
const RANK = { title: 300, index: 200, object: 100, text: 0 };
const WANTED = (new URLSearchParams(window.location.search).get("q") || "").toLowerCase().trim();

var Scorer = {
  score: ([, title, anchor, , score, , kind]) => {
    const isPage = !anchor && title.toLowerCase().includes(WANTED);
    return score + (isPage ? 400 : RANK[kind] + (kind === "text" && score >= Scorer.partialTitle ? 50 : 0));
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
