-- The card's own logic, for NI's component-level IP: conversions and encoder pins in, both FIFOs'
-- words and the push's indicators out. The ports are said in fpga/registers.toml, what they mean in
-- docs/card.md, how they are wired in fpga/README.md.
--
-- A conversion in cycle t that finishes a sample: `write` and both words in t + 1, the indicators
-- from t + 2 on; `done` in t + 2 where `push_end` came in t, so that it never comes before a word.
library ieee;
use ieee.std_logic_1164.all;
use ieee.numeric_std.all;

entity difffric_core is
  port (
    clk : in std_logic;
    aReset : in std_logic;
    converted : in std_logic;
    adc_word : in std_logic_vector(15 downto 0);
    encoder_a : in std_logic;
    encoder_b : in std_logic;
    start : in std_logic;
    push_end : in std_logic;
    contact_threshold_word : in std_logic_vector(15 downto 0);
    contact_hysteresis_word : in std_logic_vector(15 downto 0);
    average_log2 : in std_logic_vector(7 downto 0);
    fifos_have_room : in std_logic;
    write : out std_logic;
    force_word : out std_logic_vector(15 downto 0);
    position_word : out std_logic_vector(63 downto 0);
    done : out std_logic;
    samples : out std_logic_vector(31 downto 0);
    streamed : out std_logic_vector(31 downto 0);
    overflow : out std_logic;
    peak_word : out std_logic_vector(15 downto 0);
    released : out std_logic;
    release_sample : out std_logic_vector(31 downto 0);
    release_count : out std_logic_vector(31 downto 0);
    encoder_error : out std_logic;
    saturated_samples : out std_logic_vector(31 downto 0)
  );
end entity;

architecture rtl of difffric_core is
  -- aReset sets these at once and they empty with the clock; all else is reset by the clock, by the
  -- last of them. So only these three meet a reset that ends near a clock's edge, a reset while the
  -- clock stands still is not lost, and the encoder's pins are known when it ends.
  signal resetting : std_logic_vector(2 downto 0) := "111";
  signal reset : std_logic;

  signal start_before : std_logic := '1';  -- one that outlasts a reset is no edge
  signal starts : std_logic;
  signal clear : std_logic;
  signal running, ending, ended : std_logic := '0';

  signal of_the_push : std_logic;  -- this cycle's conversion is
  signal finishes : std_logic;
  signal taken : std_logic := '0';  -- a sample is there
  signal writes, closed : std_logic := '0';
  signal illegal, illegal_seen : std_logic := '0';
  signal taken_samples, written_samples : unsigned(31 downto 0) := (others => '0');

  signal count, sample_count, lost_count : signed(31 downto 0);
  signal sample_word, peak : signed(15 downto 0);
  signal sample_saturated : std_logic;
  signal saturated_now, lost_sample : unsigned(31 downto 0);

  attribute ASYNC_REG : string;
  attribute ASYNC_REG of resetting : signal is "TRUE";
begin
  process (clk, aReset)
  begin
    if aReset = '1' then
      resetting <= "111";
    elsif rising_edge(clk) then
      resetting <= resetting(1 downto 0) & '0';
    end if;
  end process;
  reset <= resetting(2);

  starts <= start and not start_before;
  clear <= reset or starts;
  of_the_push <= converted and running;

  process (clk)
  begin
    if rising_edge(clk) then
      start_before <= start or reset;
      writes <= '0';
      taken <= '0';
      if reset = '1' then
        running <= '0';
      elsif starts = '1' then
        running <= '1';  -- also where the last push ends in this very cycle
      elsif push_end = '1' then
        running <= '0';
      end if;
      if clear = '1' then
        ending <= '0';
        ended <= '0';
        closed <= '0';
        illegal_seen <= '0';
        taken_samples <= (others => '0');
        written_samples <= (others => '0');
      else
        ending <= running and push_end;
        ended <= ended or ending;
        illegal_seen <= illegal_seen or (running and illegal);
        taken <= finishes;
        if finishes = '1' and fifos_have_room = '0' then
          closed <= '1';
        elsif finishes = '1' and closed = '0' then
          writes <= '1';
        end if;
        if taken = '1' then
          taken_samples <= taken_samples + 1;
        end if;
        if writes = '1' then
          written_samples <= written_samples + 1;
        end if;
      end if;
    end if;
  end process;

  encoder : entity work.difffric_quadrature
    port map (
      clk => clk, reset => reset, a => encoder_a, b => encoder_b, count => count,
      illegal => illegal);

  average : entity work.difffric_average
    port map (
      clk => clk, clear => clear, log2 => unsigned(average_log2(2 downto 0)),
      converted => of_the_push, word => signed(adc_word), count => count, finishes => finishes,
      mean => sample_word, mean_count => sample_count, saturated => sample_saturated);

  watch : entity work.difffric_watch
    port map (
      clk => clk, clear => clear, threshold => signed(contact_threshold_word),
      hysteresis => signed(contact_hysteresis_word), taken => taken, word => sample_word,
      saturated => sample_saturated, number => taken_samples, count => sample_count, peak => peak,
      saturated_samples => saturated_now, released => released, release_sample => lost_sample,
      release_count => lost_count);

  write <= writes;
  force_word <= std_logic_vector(sample_word);
  position_word <= std_logic_vector(taken_samples) & std_logic_vector(sample_count);
  done <= ended;
  samples <= std_logic_vector(taken_samples);
  streamed <= std_logic_vector(written_samples);
  overflow <= closed;
  peak_word <= std_logic_vector(peak);
  release_sample <= std_logic_vector(lost_sample);
  release_count <= std_logic_vector(lost_count);
  encoder_error <= illegal_seen;
  saturated_samples <= std_logic_vector(saturated_now);
end architecture;
