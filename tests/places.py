"""Where the tests find files: the project's own, and the corpus of public files beside it, which may be absent."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
DATA = ROOT / "tests" / "data"
MODELS = DATA / "models"
POLICIES = DATA / "policies"
TIGER = EXAMPLES / "tiger.pomdp"
TIGER_VECTORS = EXAMPLES / "tiger.vf"
CORPUS = ROOT.parent / "shared" / "corpus"


def each(values):
    """Return the parameters of a test of foreign files: all of them, or one alone where the files are not there."""
    return [*values] if CORPUS.is_dir() else [*values][:1] or [None]


def foreign(pattern):
    """Return the paths of foreign files in the corpus, such as ``models/madp/*.pgmx``; one where they are not there."""
    return each(sorted(path.relative_to(CORPUS).as_posix() for path in CORPUS.glob(pattern) if path.is_file()))
