"""Results for readers: tables for terminals, pages and videos."""

from ptne_env.bench.report.certificates import certificate_tables as certificate_tables
from ptne_env.bench.report.certificates import check_tables as check_tables
from ptne_env.bench.report.comparison import page as page
from ptne_env.bench.report.terminal import answer_tables as answer_tables
from ptne_env.bench.report.terminal import result_tables as result_tables
from ptne_env.bench.report.terminal import show as show
from ptne_env.bench.report.video import save_video as save_video
