"""Results for people to read: tables for terminals, and a page."""

from ptne_env.report.certificates import certificate_tables as certificate_tables
from ptne_env.report.content import comparison_report as comparison_report
from ptne_env.report.content import suite_report as suite_report
from ptne_env.report.diagrams import save_diagram as save_diagram
from ptne_env.report.leaderboards import leaderboard_tables as leaderboard_tables
from ptne_env.report.leaderboards import repetition_table as repetition_table
from ptne_env.report.leaderboards import suite_table as suite_table
from ptne_env.report.page import render_page as render_page
from ptne_env.report.tables import comparison_tables as comparison_tables
from ptne_env.report.tables import entry_table as entry_table
from ptne_env.report.tables import metric_table as metric_table
from ptne_env.report.tables import scenario_table as scenario_table
from ptne_env.report.video import save_video as save_video
