-- What is seen of a push's samples as they come: the largest, those at an end of the converter, and
-- where contact was last lost.
library ieee;
use ieee.std_logic_1164.all;
use ieee.numeric_std.all;

entity difffric_watch is
  port (
    clk : in std_logic;
    clear : in std_logic;  -- a push begins: nothing is seen yet, and there is no contact
    threshold : in signed(15 downto 0);
    hysteresis : in signed(15 downto 0);
    taken : in std_logic;  -- a sample is there
    word : in signed(15 downto 0);
    saturated : in std_logic;
    number : in unsigned(31 downto 0);
    count : in signed(31 downto 0);
    peak : out signed(15 downto 0);
    saturated_samples : out unsigned(31 downto 0);
    released : out std_logic;
    release_sample : out unsigned(31 downto 0);
    release_count : out signed(31 downto 0)
  );
end entity;

architecture rtl of difffric_watch is
  signal peak_now : signed(15 downto 0) := to_signed(-32768, 16);
  signal saturated_now, sample_now : unsigned(31 downto 0) := (others => '0');
  signal count_now : signed(31 downto 0) := (others => '0');
  signal contact, released_now : std_logic := '0';
  signal makes_at : signed(16 downto 0);  -- the sum does not fit into a word
begin
  makes_at <= resize(threshold, 17) + hysteresis;
  peak <= peak_now;
  saturated_samples <= saturated_now;
  released <= released_now;
  release_sample <= sample_now;
  release_count <= count_now;

  process (clk)
  begin
    if rising_edge(clk) then
      if clear = '1' then
        peak_now <= to_signed(-32768, 16);
        saturated_now <= (others => '0');
        contact <= '0';
        released_now <= '0';
        sample_now <= (others => '0');
        count_now <= (others => '0');
      elsif taken = '1' then
        if word > peak_now then
          peak_now <= word;
        end if;
        if saturated = '1' then
          saturated_now <= saturated_now + 1;
        end if;
        if contact = '0' and word >= makes_at then
          contact <= '1';
          released_now <= '0';
        elsif contact = '1' and word < threshold then
          contact <= '0';
          released_now <= '1';
          sample_now <= number;
          count_now <= count;
        end if;
      end if;
    end if;
  end process;
end architecture;
