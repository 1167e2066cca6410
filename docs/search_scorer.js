// What people have written comes before the files of the repository.
var Scorer = {
  score: ([page, title, anchor, description, score]) =>
    /^source\/(?!README|CONTRIBUTING)/.test(page) ? score - 50 : score,
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
